"""Preset `auto` of the node: chosen by the first clouds that can be read, said once, and kept. No rclpy here."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from typing import Protocol

from svc_ros.core.auto_preset import Choice, choose_preset
from svc_ros.core.errors import InputError, TransformUnavailableError
from svc_ros.core.scan import Array, Scan
from svc_ros.ros.streams.decision import CloudReader
from svc_ros.ros.streams.worker import DropJob, Job, PairJob


class OpenParameters(Protocol):
    """Parameters that may wait for a choice."""

    @property
    def awaits_choice(self) -> bool:
        """True while the preset is `auto` and nothing has been chosen."""
        ...

    def take(self, choice: Choice) -> None:
        """Make the choice's values those of the parameters that nobody has set. Raises ConfigError."""
        ...


class FirstChoice:
    """Chooses by the job that is to be computed; for a named preset, and once it has chosen, it does nothing.

    origin_of: where the sensor stood in the frame of a cloud, (frame, stamp_ns) -> (3,) [m]; say: told the choice.
    """

    def __init__(
        self, parameters: OpenParameters, origin_of: Callable[[str, int], Array], say: Callable[[str], object]
    ) -> None:
        self._parameters, self._reader, self._say = parameters, CloudReader(origin_of), say

    def settle(self, job: Job) -> None:
        """Choose by this job's clouds, if that is still to be done. Raises ConfigError where values do not fit."""
        if not self._parameters.awaits_choice:
            return
        choice = choose_preset(list(self._scans(job)))
        if choice.outlook is not None:  # without a single point nothing is known yet
            self._parameters.take(choice)
            self._say(f"preset auto: {choice.preset}, {choice.why}; kept from now on")

    def _scans(self, job: Job) -> Iterator[Scan]:
        """The clouds that can be read; why another one cannot is said by its decision."""
        if isinstance(job, DropJob):
            return
        for cloud in (job.source, job.target) if isinstance(job, PairJob) else (job.cloud,):
            with contextlib.suppress(InputError, TransformUnavailableError):
                yield self._reader.scan(cloud)
