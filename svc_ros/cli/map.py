"""`svc_ros map`: bags become a map that lasts."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from svc_ros.cli.console import ProgressCallback, damage_told, key_value_table, summary_console
from svc_ros.cli.options import ConfigOption, PresetOption, SensorOption, StrictOption, TopicOption, read_wanted
from svc_ros.cli.replay import BagArgument, DurationOption, StartOption
from svc_ros.cli.replay_console import replay_progress
from svc_ros.core.errors import InputError

if TYPE_CHECKING:
    from svc_ros.io.bags import Bag
    from svc_ros.pipeline.map import Map
    from svc_ros.pipeline.mapping.building import Run, Tracked
    from svc_ros.replay.job import ReplayJob
    from svc_ros.replay.modes import Replay

OutOption = Annotated[Path, typer.Option("--out", metavar="DIR", help="Folder of the map; a map there is replaced.")]
OdometryOption = Annotated[
    str | None, typer.Option("--odometry-frame", metavar="FRAME", help="Odometry by /tf, else by scan matching.")
]
ExtendOption = Annotated[
    Path | None, typer.Option("--extend", metavar="MAP", help="Join the bags to this map, by its configuration.")
]


def map(
    bags: BagArgument,
    out: OutOption,
    topic: TopicOption = None,
    start: StartOption = 0.0,
    duration: DurationOption = None,
    preset: PresetOption = None,
    config_file: ConfigOption = None,
    sensor_frame: SensorOption = None,
    odometry_frame: OdometryOption = None,
    extend: ExtendOption = None,
    strict: StrictOption = False,
) -> None:
    """Build a map of one bag or several: keyframes where they stood, for localisation.

    Each bag is a run: its keyframes are placed by odometry and loops, and it is joined to those before it by loops that
    agree. A run that nothing joins for sure is an error, and no map is written.
    """
    from svc_ros.io.maps.placing import check_map_place
    from svc_ros.io.maps.reading import check_preprocess
    from svc_ros.pipeline.map import Map
    from svc_ros.pipeline.mapping.building import build_map
    from svc_ros.replay.bags import expand_bags, folder_names
    from svc_ros.replay.job import ReplayJob

    check_map_place(out)
    paths, wanted = expand_bags(bags), read_wanted(preset, None, config_file)
    config, name = wanted.first_fit(), wanted.preset
    with ExitStack() as opened:
        extended = None if extend is None else opened.enter_context(Map.read(extend))
        if extended is not None:
            if preset is not None:
                raise InputError(f"--preset {preset}: expected none beside --extend, the map has its own configuration")
            config, name = wanted.over(extended.config), str(extend)
            if config_file is not None:
                check_preprocess(config_file, config.preprocess, asdict(extended.config.preprocess))
        jobs = [
            ReplayJob(
                path, out, config, name, "loop_closure", topic, start, duration, sensor_frame=sensor_frame,
                odometry_frame=odometry_frame, report=False, values=wanted.given, strict=strict,
            )
            for path in paths
        ]  # fmt: skip
        made = opened.enter_context(build_map(_runs(jobs, folder_names(paths)), out, extended))
        summary_console(None).print(key_value_table(f"map {out}", _rows(made)))


def _runs(jobs: Sequence[ReplayJob], names: Sequence[str]) -> Iterator[Run]:
    """Each bag as a run; the first one settles the configuration of all."""
    from svc_ros.io.bags import Bag
    from svc_ros.pipeline.mapping.building import Run
    from svc_ros.replay.modes import open_replay

    settled: ReplayJob | None = None
    for job, name in zip(jobs, names, strict=True):
        with Bag(job.bag, job.strict) as bag, damage_told(bag), replay_progress(name) as on_progress:
            topic = bag.resolve_cloud_topic(job.topic)
            if settled is None:
                settled = job.settled(bag, topic)
            job = replace(job, config=settled.config, preset=settled.base)
            with open_replay(job, bag, topic, ()) as replay:
                yield Run(name, _scans(bag, replay, on_progress), job.config)


def _scans(bag: Bag, replay: Replay, on_progress: ProgressCallback) -> Iterator[Tracked]:
    from svc_ros.replay.ahead import ahead
    from svc_ros.replay.clouds import read_clouds
    from svc_ros.replay.stream import track_clouds

    assert replay.odometry is not None  # as in every loop closure
    for number, tracked in enumerate(track_clouds(ahead(read_clouds(bag, replay.part)), replay.odometry), 1):
        if tracked.cloud.scan is not None:
            yield tracked.cloud.scan, tracked.T_odom_scan
        on_progress(number, max(number, replay.num_expected))


def _rows(made: Map) -> dict[str, Any]:
    sessions, edges = made.sessions, made.graph.edges
    num_joining = sum(sessions[edge.source] != sessions[edge.target] for edge in edges)
    num_steps = len(made) - len(made.runs)
    size = sum(file.stat().st_size for file in made.folder.iterdir())
    return {
        "runs": len(made.runs),
        "keyframes": len(made),
        "loops within runs": len(edges) - num_steps - num_joining,
        "loops between runs": num_joining,
        "size [MB]": 1e-6 * size,
    }
