"""Middleware domains of programs that run at the same time."""

from __future__ import annotations

import subprocess
import sys

from svc_ros.ros.processes import own_domain_id

ASK = (
    "import sys; from svc_ros.ros.processes import own_domain_id; "
    "print(own_domain_id({salt}), flush=True); sys.stdin.read()"
)


def test_processes_at_the_same_time_have_domains_of_their_own():
    mine = own_domain_id(200)
    salts = [200 - k for k in range(4)]  # whichever number the process has, some ask for what others want
    others = [
        subprocess.Popen(
            [sys.executable, "-c", ASK.format(salt=salt)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        for salt in salts
    ]
    try:
        theirs = [int(process.stdout.readline()) for process in others]
    finally:
        for process in others:
            process.communicate()
    assert len({mine, *theirs}) == 5
    assert all(1 <= domain_id <= 101 for domain_id in (mine, *theirs))


def test_salts_have_domains_of_their_own_and_keep_them():
    first = [own_domain_id(salt) for salt in range(300, 308)]
    assert len(set(first)) == 8
    assert [own_domain_id(salt) for salt in range(300, 308)] == first


def test_more_than_a_process_keeps_may_be_asked_for():
    assert all(1 <= own_domain_id(salt) <= 101 for salt in range(400, 650))
