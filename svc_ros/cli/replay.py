"""`svc_ros replay`: bags through the registration, with every decision on disk."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from svc_ros.cli.console import make_output_folder, note, progress, warn_of_damage
from svc_ros.cli.exit_codes import INTERRUPTED
from svc_ros.cli.options import (
    ConfigOption,
    MethodOption,
    PresetOption,
    ReferenceFrameOption,
    SchedulerOption,
    SensorOption,
    StrictOption,
    TopicOption,
    read_wanted,
)
from svc_ros.cli.replay_console import print_summary, replay_progress, stop_request
from svc_ros.core.errors import InputError

if TYPE_CHECKING:
    from svc_ros.replay.job import ReplayJob
    from svc_ros.replay.spread import ReplayedBags

BagArgument = Annotated[
    list[str],
    typer.Argument(metavar="BAG...", help="ROS 1 .bag; ROS 2 folder, .mcap or .db3; or quoted patterns ('runs/*')."),
]
OutOption = Annotated[
    Path, typer.Option("--out", metavar="DIR", help="Folder for all outputs; with several bags one below it for each.")
]
ModeOption = Annotated[
    str,
    typer.Option(
        "--mode",
        metavar="MODE",
        help="pair: scan k + stride against scan k; scan_matching; loop_closure; localization.",
    ),
]
StartOption = Annotated[float, typer.Option("--start", min=0.0, metavar="S", help="Seconds from the bag's begin.")]
DurationOption = Annotated[float | None, typer.Option("--duration", metavar="S", help="Seconds from there; else all.")]
StrideOption = Annotated[
    int,
    typer.Option("--stride", min=1, metavar="K", help="pair: scans between the two; else: every K-th scan is taken."),
]
MaxRateOption = Annotated[
    float | None, typer.Option("--max-rate", metavar="HZ", help="Most scans a second of wall time; else all it can.")
]
ResumeOption = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue an interrupted run in DIR of the same bag, mode and configuration. Pairs are not registered "
        "again; the other modes go through the earlier scans once more.",
    ),
]
InputOption = Annotated[bool, typer.Option("--with-input", help="Copy clouds and transforms into results.mcap.")]
ReportOption = Annotated[bool, typer.Option("--report/--no-report", help="Write report.html.")]
OdometryOption = Annotated[
    str | None,
    typer.Option(
        "--odometry-frame", metavar="FRAME", help="loop_closure, localization: odometry by /tf, else by scan matching."
    ),
]
ReferenceOption = Annotated[
    Path | None, typer.Option("--reference", metavar="TUM", help="Reference trajectory; errors are added and shown.")
]
MapOption = Annotated[
    Path | None, typer.Option("--map", metavar="DIR", help="localization: the map, whose configuration counts.")
]
MapReferenceOption = Annotated[
    Path | None,
    typer.Option("--map-reference", metavar="TUM", help="Reference of the map's scans, where --reference has none."),
]


def replay(
    bags: BagArgument,
    out: OutOption,
    topic: TopicOption = None,
    mode: ModeOption = "pair",
    start: StartOption = 0.0,
    duration: DurationOption = None,
    stride: StrideOption = 1,
    max_rate: MaxRateOption = None,
    resume: ResumeOption = False,
    preset: PresetOption = None,
    method: MethodOption = None,
    config_file: ConfigOption = None,
    sensor_frame: SensorOption = None,
    odometry_frame: OdometryOption = None,
    reference: ReferenceOption = None,
    reference_frame: ReferenceFrameOption = None,
    map_folder: MapOption = None,
    map_reference: MapReferenceOption = None,
    with_input: InputOption = False,
    report: ReportOption = True,
    scheduler: SchedulerOption = None,
    strict: StrictOption = False,
) -> None:
    """Decide on the scans of bags, as the node would, as fast as the machine allows.

    DIR gets decisions.jsonl, trajectory_tum.txt, loops.g2o, results.mcap, config.yaml, summary.json, report.html.
    Several bags: each leaves these in DIR/NAME, named like the bag, and DIR/summary.json tells of all of them; a bag
    that cannot be read does not keep the others. Ctrl-C ends it after the scan at hand, with complete outputs.
    """
    from svc_ros.replay.bags import expand_bags, jobs_of
    from svc_ros.replay.job import ReplayJob

    paths = expand_bags(bags)
    if map_folder is not None and preset is not None:
        raise InputError(f"--preset {preset}: expected none beside --map, the map has its own configuration")
    wanted = read_wanted(preset, method, config_file)
    job = ReplayJob(
        paths[0], out, wanted.first_fit(), wanted.preset if map_folder is None else "map", mode, topic, start, duration,
        stride, max_rate, sensor_frame, odometry_frame, reference, reference_frame, with_input, resume, report,
        wanted.given, map_folder=map_folder, map_reference=map_reference, strict=strict,
    )  # fmt: skip
    if len(paths) == 1 and scheduler is None:
        interrupted = _replay_one(job)
    else:
        interrupted = _replay_several(jobs_of(paths, job), out, scheduler)
    if interrupted:
        note(f"interrupted: {out} holds what was decided so far; go on with --resume")
        raise typer.Exit(INTERRUPTED)


def _replay_one(job: ReplayJob) -> bool:
    """True if it was interrupted."""
    from svc_ros.replay.run import replay_bag

    with stop_request() as stopped, replay_progress("replaying") as on_progress:
        summary = replay_bag(job, on_progress, stopped)
    _warn([summary])
    print_summary(f"{job.bag} {summary['topic']}: {_how(job, summary)}", summary, job.out)
    return bool(summary["state"] != "complete")


def _replay_several(jobs: Sequence[ReplayJob], out: Path, scheduler: str | None) -> bool:
    """True if it was interrupted. Raises InputError at the end where a bag could not be replayed."""
    from svc_ros.replay.bags import write_common_summary
    from svc_ros.replay.spread import replay_over

    make_output_folder(out)
    if scheduler is None:
        done = _one_by_one(jobs)
    else:
        with progress(f"replaying {len(jobs)} bags") as on_progress:
            done = replay_over(scheduler, jobs, on_progress)
    alone = len(jobs) == 1  # its own summary stands in the folder itself
    common = {} if alone else write_common_summary(out, jobs, done.summaries, done.errors)
    summary: dict[str, Any] = common or next(iter(done.summaries.values()), {})
    _warn(done.summaries.values())
    if done.summaries:
        print_summary(f"{len(done.summaries)} of {len(jobs)} bags: {_how(jobs[0], summary)}", summary, out)
    if done.errors:
        text = f"{len(done.errors)} of {len(jobs)} bags could not be replayed"
        raise InputError(f"{text}: {next(iter(done.errors.values()))}")
    return bool(done.interrupted or summary.get("interrupted") or summary.get("num_not_begun"))


def _one_by_one(jobs: Sequence[ReplayJob]) -> ReplayedBags:
    from svc_ros.replay.run import replay_bag
    from svc_ros.replay.spread import ReplayedBags

    done = ReplayedBags()
    with stop_request() as stopped:
        for number, job in enumerate(jobs, 1):
            if stopped():
                break
            with replay_progress(f"{number}/{len(jobs)} {job.out.name}") as on_progress:
                try:
                    done.summaries[job.out] = replay_bag(job, on_progress, stopped)
                except InputError as error:
                    done.errors[job.out] = str(error)
    return done


def _warn(summaries: Iterable[Mapping[str, Any]]) -> None:
    warn_of_damage(damage["message"] for summary in summaries for damage in summary.get("damage", ()))


def _how(job: ReplayJob, summary: Mapping[str, Any]) -> str:
    """What was replayed with which configuration; of several bags each had its own choice, which its summary tells."""
    chosen = summary.get("chosen")
    why = f": {chosen['preset']}, {chosen['why']}" if chosen else ""
    return f"mode {job.mode}, method {job.config.method}, preset {job.preset}{why}"
