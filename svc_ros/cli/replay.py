"""`svc_ros replay`: a bag through the registration, with every decision on disk."""

from __future__ import annotations

import signal
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import FrameType
from typing import TYPE_CHECKING, Annotated, Any

import typer
from rich.text import Text

from svc_ros.cli.console import key_value_table, make_output_folder, note, progress, summary_console
from svc_ros.cli.exit_codes import INTERRUPTED
from svc_ros.cli.options import ConfigOption, MethodOption, PresetOption, resolve_settings
from svc_ros.core.config import unknown_name
from svc_ros.core.errors import InputError

if TYPE_CHECKING:
    from svc_ros.cli.reference import Reference
    from svc_ros.pipeline.replay import ReplayedPair

MODES = ("pair",)
_LATER_MODES = ("scan_matching", "loop_closure")

BagArgument = Annotated[Path, typer.Argument(metavar="BAG", help="ROS 1 .bag, or a ROS 2 bag: folder, .mcap or .db3.")]
OutOption = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Folder for decisions.jsonl, results.mcap and config.yaml.")
]
TopicOption = Annotated[str | None, typer.Option("--topic", metavar="TOPIC", help="Needed where several have clouds.")]
ModeOption = Annotated[str, typer.Option("--mode", metavar="MODE", help="pair: scan k + stride against scan k.")]
StrideOption = Annotated[int, typer.Option("--stride", min=1, metavar="K", help="Scans between the two of a pair.")]
SensorOption = Annotated[
    str | None,
    typer.Option("--sensor-frame", metavar="FRAME", help="Sensor's frame, where the clouds are in another one."),
]
ReferenceOption = Annotated[
    Path | None, typer.Option("--reference", metavar="TUM", help="Reference trajectory; errors are added and shown.")
]
ReferenceFrameOption = Annotated[
    str | None,
    typer.Option("--reference-frame", metavar="FRAME", help="Whose poses these are; the clouds' frame by default."),
]


@dataclass
class _Tally:
    """What the summary tells."""

    verdicts: Counter[str] = field(default_factory=Counter)
    reasons: Counter[str] = field(default_factory=Counter)
    accepted_errors: list[tuple[float, float]] = field(default_factory=list)
    without_reference: int = 0
    with_reference: bool = False

    def add(self, pair: ReplayedPair, errors: tuple[float, float] | None) -> None:
        self.verdicts[pair.result.verdict.value] += 1
        self.reasons[pair.result.reason.value] += 1
        if pair.result.accepted and errors is not None:
            self.accepted_errors.append(errors)
        elif pair.result.accepted:
            self.without_reference += 1

    def rows(self) -> dict[str, Any]:
        rows: dict[str, Any] = {"pairs": self.verdicts.total(), **self.verdicts}
        rows |= {f"reason {name}": count for name, count in sorted(self.reasons.items())}
        if not self.with_reference:
            return rows
        rotation, translation = zip(*self.accepted_errors, strict=True) if self.accepted_errors else ((), ())
        rows["accepted, largest rotation error [deg]"] = max(rotation, default=None)
        rows["accepted, largest translation error [m]"] = max(translation, default=None)
        rows["accepted, without a reference"] = self.without_reference
        return rows


def replay(
    bag_path: BagArgument,
    out: OutOption,
    topic: TopicOption = None,
    mode: ModeOption = "pair",
    stride: StrideOption = 1,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    sensor_frame: SensorOption = None,
    reference: ReferenceOption = None,
    reference_frame: ReferenceFrameOption = None,
) -> None:
    """Register the scans of a bag pair by pair, as the node would. Ctrl-C ends it after the pair at hand."""
    _check_mode(mode)
    settings = resolve_settings(preset, method, config_file)
    from svc_ros.cli.reference import Reference
    from svc_ros.io.bags import Bag
    from svc_ros.io.config_yaml import config_to_yaml
    from svc_ros.pipeline.replay import replay_pairs

    with Bag(bag_path) as bag:
        chosen = bag.resolve_cloud_topic(topic)
        truth = None if reference is None else Reference.read(reference, bag, reference_frame)
        make_output_folder(out)
        (out / "config.yaml").write_text(config_to_yaml(settings.config, settings.preset), encoding="utf-8")
        pairs = replay_pairs(bag, chosen, settings.config, stride, sensor_frame)
        tally, interrupted = _write_decisions(pairs, out, max(bag.num_scans(chosen) - stride, 0), truth)
    title = f"{bag_path} {chosen}: method {settings.config.method}, preset {settings.preset}"
    summary_console(None).print(Text(title, "bold"), soft_wrap=True)
    summary_console(None).print(key_value_table("", tally.rows()))
    if interrupted:
        note(f"interrupted: {out} holds the {tally.verdicts.total()} pairs decided so far")
        raise typer.Exit(INTERRUPTED)


def _check_mode(mode: str) -> None:
    if mode in _LATER_MODES:
        raise InputError(f"--mode {mode}: not available in this version (available: {', '.join(MODES)})")
    if mode not in MODES:
        raise InputError(unknown_name("--mode", mode, MODES))


def _write_decisions(
    pairs: Iterator[ReplayedPair], out: Path, total: int, truth: Reference | None
) -> tuple[_Tally, bool]:
    """Write every decision to both files as soon as it is made; True if it was interrupted."""
    from svc_ros.io.bags import ResultWriter

    tally = _Tally(with_reference=truth is not None)
    with (
        progress("replaying") as on_progress,
        _stop_request() as stopped,
        (out / "decisions.jsonl").open("w", encoding="utf-8", buffering=1) as lines,
        ResultWriter(out / "results.mcap") as results,
    ):
        for pair in pairs:
            errors = truth.errors(pair) if truth is not None else None
            lines.write(_json_line(pair, truth is not None, errors))
            results.write(
                pair.result, pair.source_stamp_ns, pair.target_stamp_ns, pair.source_frame, pair.target_frame
            )
            tally.add(pair, errors)
            on_progress(tally.verdicts.total(), total)
            if stopped():
                return tally, True
    return tally, False


def _json_line(pair: ReplayedPair, with_reference: bool, errors: tuple[float, float] | None) -> str:
    from svc_ros.io.results import json_line, result_to_json

    extra: dict[str, Any] = {
        "source_stamp_ns": pair.source_stamp_ns,
        "target_stamp_ns": pair.target_stamp_ns,
        "source_index": pair.source_index,
        "target_index": pair.target_index,
        "source_frame": pair.source_frame,
        "target_frame": pair.target_frame,
    }
    if with_reference:
        rotation, translation = errors or (None, None)
        extra |= {"rotation_error_deg": rotation, "translation_error_m": translation}
    return json_line(result_to_json(pair.result, **extra)) + "\n"


@contextmanager
def _stop_request() -> Iterator[Callable[[], bool]]:
    """Turn the first Ctrl-C (or SIGTERM) into a question that is asked between pairs; the second one acts at once."""
    requests: list[int] = []

    def ask(signum: int, _: FrameType | None) -> None:
        requests.append(signum)
        if len(requests) > 1:
            raise KeyboardInterrupt
        note("stopping after this pair (again: at once)")

    before = {number: signal.signal(number, ask) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: bool(requests)
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
