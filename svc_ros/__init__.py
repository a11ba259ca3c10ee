"""Register LiDAR scans, and know when the answer is wrong."""

from svc_ros.core.config import Config, preset
from svc_ros.core.errors import SvcError
from svc_ros.core.registration import extract_features, prepare, register, verify
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Correspondences, Scan

__version__ = "0.1.0"

__all__ = [
    "Config",
    "Correspondences",
    "Reason",
    "RegistrationResult",
    "Scan",
    "SvcError",
    "Verdict",
    "extract_features",
    "prepare",
    "preset",
    "register",
    "verify",
]
