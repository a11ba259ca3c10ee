"""Register LiDAR scans, and know when the answer is wrong."""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from svc_ros.core.auto_preset import choose_preset
    from svc_ros.core.config import Config, preset
    from svc_ros.core.errors import SvcError
    from svc_ros.core.registration import extract_features, prepare, register, verify
    from svc_ros.core.result import Reason, RegistrationResult, Verdict
    from svc_ros.core.scan import Correspondences, Description, PreparedScan, Scan

__version__ = "0.1.0"

__all__ = [
    "Config",
    "Correspondences",
    "Description",
    "PreparedScan",
    "Reason",
    "RegistrationResult",
    "Scan",
    "SvcError",
    "Verdict",
    "choose_preset",
    "extract_features",
    "prepare",
    "preset",
    "register",
    "verify",
]

# Open3D and numba take seconds to import; a name is fetched when it is first asked for, so that
# `svc_ros --help` and `from svc_ros.io import ...` do not wait for them.
_HOMES = {
    "svc_ros.core.auto_preset": ("choose_preset",),
    "svc_ros.core.config": ("Config", "preset"),
    "svc_ros.core.errors": ("SvcError",),
    "svc_ros.core.registration": ("extract_features", "prepare", "register", "verify"),
    "svc_ros.core.result": ("Reason", "RegistrationResult", "Verdict"),
    "svc_ros.core.scan": ("Correspondences", "Description", "PreparedScan", "Scan"),
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(_HOME_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
