"""What is sent on a topic now, and whether it can be registered: a program of the ROS layer listens for a while.

It is a process of its own because nothing here imports ROS, and because whoever looks at clouds meanwhile hears less.
"""

from __future__ import annotations

import subprocess
import sys
import tempfile
from collections import Counter
from pathlib import Path

from svc_ros.cli.doctor.arrivals import check_age, check_arrivals
from svc_ros.cli.doctor.bag import advice_on_type, check_frame_names
from svc_ros.cli.doctor.clouds import check_clouds, suggest_preset
from svc_ros.cli.doctor.endpoints import check_endpoints
from svc_ros.cli.doctor.finding import Finding
from svc_ros.cli.doctor.notes import TRIED, CloudNotes, notes_of
from svc_ros.cli.doctor.stamps import check_stamps
from svc_ros.cli.doctor.trial import try_pairs
from svc_ros.core.errors import InputError
from svc_ros.io.clouds.livox import LIVOX_TYPE, NO_LIVOX_PACKAGE
from svc_ros.io.clouds.point_cloud2 import CLOUD_TYPE
from svc_ros.io.heard import Heard, read_heard


def check_topic(topic: str, seconds: float, trial: bool = False) -> list[Finding]:
    """Listen to a topic, and look at what came; trial: register a few neighbouring scans as well.

    Raises InputError where rclpy is missing, where nobody publishes clouds on the topic, and for names that no topic
    can have.
    """
    return check_heard(listen(topic, seconds), trial)


def listen(topic: str, seconds: float) -> Heard:
    """What is heard on a topic in so many seconds, on the domain and by the middleware of this environment."""
    with tempfile.TemporaryDirectory(prefix="svc_ros_doctor_") as folder:
        command = [sys.executable, "-m", "svc_ros.ros.listen", f"--seconds={seconds:g}", f"--out={folder}", "--", topic]
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
        if done.returncode:
            last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
            raise InputError(f"cannot listen to {topic}: {last}")
        return read_heard(Path(folder))


def check_heard(heard: Heard, trial: bool = False) -> list[Finding]:
    """Everything that is to be said of what was heard. Raises InputError where nobody publishes clouds."""
    if not heard.type:
        raise InputError(_no_clouds(heard))
    findings = check_endpoints(heard)
    if heard.arrivals:
        notes = _notes(heard)
        findings += check_arrivals(heard)
        findings += check_clouds(notes)
        findings += check_stamps([a.stamp_ns for a in heard.arrivals])
        findings += check_age(heard.arrivals)
        findings += check_frame_names(list(Counter(a.frame_id for a in heard.arrivals)))
        if trial and not any(finding.level == "error" for finding in findings):
            findings += try_pairs(notes.pairs, suggest_preset(notes).preset)
    else:
        advice = f"the driver runs and sends nothing, or all is lost on the way; {heard.cure}"
        findings.append(Finding("clouds", "error", f"none in {heard.seconds:g} s, though they are published", advice))
    return [Finding(f"{heard.topic} {f.name}", f.level, f.found, f.advice) for f in findings]


def _no_clouds(heard: Heard) -> str:
    if heard.publishers:
        publisher = heard.publishers[0]
        advice = NO_LIVOX_PACKAGE if publisher.type == LIVOX_TYPE else advice_on_type(publisher.type)
        advice = advice or f"topics with clouds: {_listed(heard)}"
        return f"{heard.topic}: expected {CLOUD_TYPE}, found {publisher.type} of {publisher.node}: {advice}"
    if heard.num_nodes or heard.cloud_topics:
        return f"{heard.topic}: nobody publishes it; topics with clouds: {_listed(heard)} ({heard.where})"
    return (
        f"{heard.topic}: no ROS node is seen at all: start the driver, or set what is set in its terminal "
        f"(here {heard.where})"
    )


def _listed(heard: Heard) -> str:
    return ", ".join(heard.cloud_topics) or "none"


def _notes(heard: Heard) -> CloudNotes:
    """All clouds that were kept are looked at; of those that came one right after the other, some as pairs."""
    indices = sorted(heard.kept)
    neighbours = [k for k in range(len(indices) - 1) if indices[k + 1] == indices[k] + 1]
    every = max(1, len(neighbours) // TRIED)
    clouds = ((arrival.received_ns, cloud) for arrival, cloud in heard.clouds())
    return notes_of(clouds, lambda _frame, _stamp: None, 1, neighbours[::every][:TRIED])
