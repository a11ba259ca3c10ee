"""Do clouds reach the node as drivers send them, and does it keep up? Clouds of a bag at a sensor's rate, best effort.

    python benchmarks/live.py [--rate HZ] [--seconds S] [--profile] [--bag BAG --reference TUM] [--out DIR]

Three processes: the node with its defaults in mode scan_matching, a driver that knows nothing of it (with --profile
both have config/fastdds_large_clouds.xml), and this one, which listens. Without a bag a street is simulated, 60 scans
of 130,000 points, and driven there and back. Writes live.json; exit code 1 if a cloud is lost or a pose is wrong.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from lib.common import describe_run, parse_options, print_table, write_report

COLUMNS = (
    "sent", "received", "lost", "decisions", "accepted", "superseded", "wrong", "latency_ms_p50", "latency_ms_p95",
    "resident_mb_middle", "resident_mb_end", "load",
)  # fmt: skip


def main() -> None:
    """Run, print, write."""

    def extend(parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--rate", type=float, default=20.0, help="clouds a second")
        parser.add_argument("--seconds", type=float, default=60.0, help="time of play")
        parser.add_argument("--bag", type=Path, help="bag to play; simulated where none is given")
        parser.add_argument("--reference", type=Path, help="TUM file with the pose of each cloud of the bag")
        parser.add_argument("--preset", default="lidar_outdoor", help="of the bag")
        parser.add_argument("--profile", action="store_true", help="both processes use the shipped profile")

    options = parse_options("Clouds at a sensor's rate, as drivers send them.", extend, workers=False)
    run = describe_run([])
    with tempfile.TemporaryDirectory(prefix="svc_ros_live_") as folder:
        found = drive(options, Path(folder))
    settings = {name: getattr(options, name) for name in ("rate", "seconds", "preset", "profile")}
    settings["bag"] = options.bag.name if options.bag else "simulated street"
    print_table("Live", COLUMNS, [[found[name] for name in COLUMNS]])
    write_report(options.out / ("live_profile.json" if options.profile else "live.json"), {**settings, **found}, run)
    if found["lost"] or found["wrong"] or found["decisions"] != found["sent"]:
        sys.exit(f"failed: {found['lost']} lost, {found['wrong']} wrong, {found['decisions']} decisions")


def drive(options: argparse.Namespace, folder: Path) -> dict[str, Any]:
    """Play, listen, count."""
    from lib.live_bench import listen
    from lib.live_driver import order_of, stamp_of

    from svc_ros.io.trajectories import read_tum
    from svc_ros.simulation import DriveConfig, simulate_drive

    bag, reference = options.bag, options.reference
    if bag is None:
        drive_config = DriveConfig(sensor="HDL-64E", num_scans=60, spacing_m=0.3, rate_hz=20.0, seed=3)
        simulated = simulate_drive(folder / "drive", drive_config)
        bag, reference = simulated.bag, simulated.reference
    heard = listen(bag, options, folder)
    truth = read_tum(reference).poses
    places = {stamp_of(k, options.rate): i for k, i in zip(range(heard.sent), order_of(len(truth)), strict=False)}
    wrong = sum(is_wrong(values, truth, places) for values in heard.decisions)
    latency = np.array([float(values["latency_ms"]) for values in heard.decisions if "latency_ms" in values])
    verdicts = [values["verdict"] for values in heard.decisions]
    third = max(len(heard.resident_mb) // 3, 1)
    return {
        "sent": heard.sent, "received": heard.status["received"]["points"], "lost": heard.status["lost"]["points"],
        "decisions": len(verdicts), "accepted": verdicts.count("accepted"),
        "superseded": sum(values["reason"] == "superseded" for values in heard.decisions), "wrong": wrong,
        "latency_ms_p50": float(np.percentile(latency, 50)), "latency_ms_p95": float(np.percentile(latency, 95)),
        "resident_mb_middle": float(np.median(heard.resident_mb[third : 2 * third])),
        "resident_mb_end": float(np.median(heard.resident_mb[-third:])), "load": heard.load,
        "reasons": heard.status["reasons"], "played_s": heard.played_s,
    }  # fmt: skip


def is_wrong(values: dict[str, str], truth: np.ndarray, places: dict[int, int]) -> bool:
    """True for an accepted pose that is not the reference's."""
    from svc_ros.core import se3
    from svc_ros.evaluation.bag_reference import MAX_ROTATION_DEG, MAX_TRANSLATION_M
    from svc_ros.io.stamps import ns_from_text

    if values["verdict"] != "accepted":
        return False
    source, target = (truth[places[ns_from_text(values[f"{side}_stamp"])]] for side in ("source", "target"))
    error = se3.pose_error(np.array(json.loads(values["T_target_source"])), se3.invert(target) @ source)
    return error[0] > MAX_ROTATION_DEG or error[1] > MAX_TRANSLATION_M


if __name__ == "__main__":
    main()
