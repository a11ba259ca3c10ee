"""The methods by name: how each chooses a pose, and how it judges one that it is given."""

from __future__ import annotations

from collections.abc import Callable

from svc_ros.core.baselines import choose_paper, choose_sc2, verify_paper, verify_sc2
from svc_ros.core.matches.matcher import Matcher
from svc_ros.core.pair import Pair
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array
from svc_ros.core.search.looks import find_pose
from svc_ros.core.selection import verify_svc

METHODS: dict[str, Callable[[Pair, Matcher], RegistrationResult]] = {
    "sc2": choose_sc2,
    "svc_paper": choose_paper,
    "svc": find_pose,
}
VERIFIERS: dict[str, Callable[[Pair, Array], RegistrationResult]] = {
    "sc2": verify_sc2,
    "svc_paper": verify_paper,
    "svc": verify_svc,
}
