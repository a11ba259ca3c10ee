"""One pair in, one result out: what cannot be registered becomes a decision too.

The node, the bag replay and the evaluation all ask here, so that they agree on what a broken scan is called.
"""

from __future__ import annotations

import logging

from svc_ros.core.config import Config
from svc_ros.core.errors import (
    ConfigError,
    InputError,
    MissingDependencyError,
    TooFewPointsError,
    TransformUnavailableError,
)
from svc_ros.core.registration import register
from svc_ros.core.result import Reason, RegistrationResult, Verdict
from svc_ros.core.scan import Correspondences, Features, Scan

_log = logging.getLogger(__name__)


def register_pair(
    source: Scan | Features, target: Scan | Features, config: Config, correspondences: Correspondences | None = None
) -> RegistrationResult:
    """Register `source` to `target`; a scan that cannot be registered is a REJECTED result, never an exception.

    Raises ConfigError and MissingDependencyError only: those say that no pair at all can be registered.
    """
    try:
        return register(source, target, config, correspondences)
    except (ConfigError, MissingDependencyError):
        raise
    except Exception as error:
        return refused(error, config)


def refused(error: Exception, config: Config) -> RegistrationResult:
    """The REJECTED result of a pair whose registration raised `error`; `detail` carries the error's text.

    Errors outside the package's own family are defects: `internal_error`, with a traceback in the log.
    """
    reason = _reason_of(error)
    detail = str(error)
    if reason is Reason.INTERNAL_ERROR:
        detail = f"{type(error).__name__}: {error}"
        _log.error("a pair could not be registered", exc_info=error)
    return RegistrationResult(Verdict.REJECTED, reason, config.method, detail=detail)


def dropped(reason: Reason, detail: str = "", method: str = "") -> RegistrationResult:
    """The result of a pair, or of a scan without a partner, that was never registered."""
    return RegistrationResult(Verdict.DROPPED, reason, method, detail=detail)


def _reason_of(error: Exception) -> Reason:
    if isinstance(error, TooFewPointsError):
        return Reason.TOO_FEW_POINTS
    if isinstance(error, TransformUnavailableError):
        return Reason.TF_UNAVAILABLE
    if isinstance(error, InputError):
        return Reason.UNSUPPORTED_CLOUD
    return Reason.INTERNAL_ERROR
