"""Every reason of a decision in words: what it means and what to do about it. docs/reference.md has the same table."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

from svc_ros.core.result import Reason, Verdict


class ReasonText(NamedTuple):
    """Two half sentences for a person, without a final stop."""

    meaning: str
    advice: str


REASON_TEXTS: Mapping[Reason, ReasonText] = MappingProxyType({
    Reason.OK: ReasonText("the pose is right", "use it"),
    Reason.SIGHT_VIEW_BLOCKED: ReasonText(
        "one scan has surface where the other sensor looked through, or the same surface seen from both sides",
        "nothing, if the places differ; else check sensor_origin, ranges, and that the cloud is of one sensor",
    ),
    Reason.LOW_OVERLAP: ReasonText(
        "too little surface of both scans agrees",
        "scans nearer to each other; ranges that keep more of the scene",
    ),
    Reason.AMBIGUOUS: ReasonText(
        "another pose fits about as well, or a given pose was moved away by refinement",
        "a better guess, or scans with more structure",
    ),
    Reason.INSUFFICIENT_EVIDENCE: ReasonText(
        "surfaces leave a direction open (a corridor), or too little agrees",
        "wait for a scan with more structure",
    ),
    Reason.UNCONFIRMED: ReasonText(
        "a loop that agrees with neither odometry nor other loops, or that surer loops contradict",
        "nothing: a later loop may confirm it; if many are right, check odometry and agreement.drift_ratio",
    ),
    Reason.TOO_FEW_CORRESPONDENCES: ReasonText(
        "hardly any matching descriptors", "a smaller preprocess.voxel_size_m, the right preset"
    ),
    Reason.NO_HYPOTHESIS: ReasonText(
        "the matches agree on no pose",
        "usually different places; else a smaller preprocess.voxel_size_m, the right preset",
    ),
    Reason.DEGENERATE: ReasonText(
        "the matches lie on a line or a point and fix no pose", "scans with more structure"
    ),
    Reason.TOO_FEW_POINTS: ReasonText(
        "too few points after range crop and voxel grid",
        "go by the detail; check preprocess.min_range_m, preprocess.max_range_m, preprocess.voxel_size_m",
    ),
    Reason.UNSUPPORTED_CLOUD: ReasonText(
        "the cloud cannot be read; the detail says what was expected and found",
        "fix the driver, or ask svc_ros doctor BAG, or svc_ros doctor --live TOPIC",
    ),
    Reason.TF_UNAVAILABLE: ReasonText(
        "no transform from sensor_frame to the cloud's frame at its stamp, or one for two scans with one stamp",
        "publish it, raise tf_timeout, or set sensor_origin; two scans with one stamp belong in their sensors' frames",
    ),
    Reason.TIME_SKEW: ReasonText("no partner within max_skew", "raise max_skew, or give both clouds one stamp"),
    Reason.STALE: ReasonText(
        "the stamps jumped back, or the node was reset", "nothing: a bag started again"
    ),
    Reason.SUPERSEDED: ReasonText(
        "a newer pair came first (the queue was full), or the other stream is silent; in loop_closure also: newer "
        "keyframes came before this one's candidates could be judged",
        "process_every for a replay; fewer pairs, or larger voxels",
    ),
    Reason.INACTIVE: ReasonText("the node is disabled or not active", "call ~/enable, or activate it"),
    Reason.INTERNAL_ERROR: ReasonText(
        "a defect of this software, or of a descriptor that the detail names; the log has the traceback", "report it"
    ),
})  # fmt: skip

VERDICT_TEXTS: Mapping[Verdict, str] = MappingProxyType({
    Verdict.ACCEPTED: "both scans see the same surfaces from the same sides, and neither stands in the other's way",
    Verdict.REJECTED: "the best pose that was found is contradicted, or there is none, or a cloud cannot be used",
    Verdict.UNDECIDED: "what was seen neither confirms nor contradicts the pose; never treat it as accepted",
    Verdict.DROPPED: "the pair, or the cloud without a partner, was never registered",
})  # fmt: skip
