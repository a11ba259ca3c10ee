"""Domains of the middleware that two runs on one machine do not share."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytest.importorskip("rclpy", reason="needs rclpy (pip install svc_ros[ros])")

from svc_ros.ros.processes import own_domain_id

TAKES_THIRTY = """
import sys
from svc_ros.ros.processes import own_domain_id
print(*(own_domain_id(salt) for salt in range(1000, 1030)), flush=True)
sys.stdin.read()
"""


def test_a_salt_keeps_its_domain():
    assert own_domain_id(300) == own_domain_id(300)
    assert len({own_domain_id(salt) for salt in (300, 307, 314)}) == 3


def test_processes_that_run_at_the_same_time_have_different_domains():
    """Sixty of a hundred: by chance that does not happen."""
    runs = [
        subprocess.Popen([sys.executable, "-c", TAKES_THIRTY], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    try:
        taken = [set(map(int, run.stdout.readline().split())) for run in runs]
    finally:
        for run in runs:
            run.communicate("")
    assert [len(domains) for domains in taken] == [30, 30]
    assert taken[0].isdisjoint(taken[1])
    assert taken[0] | taken[1] <= set(range(1, 102))
