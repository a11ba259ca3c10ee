"""Arguments of the launch files that nobody gave, found in the running system or in a bag.

What is given always wins. Each finding is told in one line.
"""

from __future__ import annotations

from collections.abc import Mapping

from svc_ros.core.errors import InputError
from svc_ros.io.bags import Bag
from svc_ros.ros.discovery.choice import Choice, choose_base, choose_points, cloud_topics, describe_pair

Values = dict[str, str]

USUAL = {"source": "source_points", "target": "target_points", "points": "points"}  # by argument
_EARLY_NS = 10_000_000_000  # static transforms stand at the beginning of a bag; whole bags take long to read


def full_name(topic: str, namespace: str) -> str:
    """A topic's name with its namespace, which is what qos_overrides go by."""
    return topic if topic.startswith("/") else "/" + "/".join(filter(None, (namespace.strip("/"), topic)))


def find_live(given: Mapping[str, str]) -> tuple[Values, list[str]]:
    """Values of registration.launch.py's arguments with those that were found, and what to say about them.

    Raises InputError where several topics could be meant.
    """
    usual = {name: full_name(topic, given["namespace"]) for name, topic in USUAL.items()}
    values = {**given, **{name: topic for name, topic in USUAL.items() if not given[name]}}
    asked = [name for name in (("source", "target") if given["mode"] == "pair" else ("points",)) if not given[name]]
    wants_base = _wants_base(given)
    if not asked and not wants_base:
        return values, []
    from svc_ros.ros.discovery.graph import Onlooker

    said = []
    with Onlooker() as onlooker:
        if asked:
            clouds = onlooker.clouds(lambda seen: {usual[name] for name in asked} <= set(seen))
            if given["mode"] == "pair":
                named = {name: full_name(values[name], given["namespace"]) for name in ("source", "target")}
                said.append(describe_pair(clouds, named))
            else:
                streams = [name for name in clouds if name not in (usual["source"], usual["target"])]
                choice = choose_points(streams, usual["points"], "on the graph", "points")
                values["points"] = USUAL["points"] if choice.name == usual["points"] else choice.name
                said.append(choice.why)
        points = full_name(values["points"], given["namespace"])
        frame = onlooker.frame_of(points) if wants_base else ""
        if wants_base and not frame:
            said.append(f"base_frame stays the clouds' own: no cloud came on {points} to tell which that is")
        if frame:
            parents = onlooker.static_parents(lambda known: choose_base(frame, known) is not None)
            if base := choose_base(frame, parents):
                values["base_frame"] = base.name
                said.append(base.why)
    return values, said


def find_in_bag(given: Mapping[str, str]) -> tuple[Values, list[str]]:
    """`points` and `base_frame` of a bag whose every topic is played, as far as they are found, and what to say.

    given: `bag`, `mode`, `topic`, `publish_tf`, `base_frame`. Raises InputError where several topics could be meant.
    """
    values: Values = {"points": given["topic"]} if given["topic"] else {}
    said = []
    if given["mode"] != "pair" and not values:
        choice = choose_points(_clouds_in(given["bag"]), f"/{USUAL['points']}", f"in {given['bag']}", "topic")
        values["points"] = choice.name
        said.append(choice.why)
    if _wants_base(given) and (base := _base_in(given["bag"], values["points"])):
        values["base_frame"] = base.name
        said.append(base.why)
    return values, said


def _clouds_in(path: str) -> list[str]:
    """Topics of clouds; none in what only the player itself can read, or says that it cannot."""
    try:
        with Bag(path) as bag:
            return cloud_topics((topic.name, [topic.type], topic.count) for topic in bag.topics)
    except InputError:
        return []


def _base_in(path: str, points: str) -> Choice | None:
    """The base that the first cloud's frame is fixed to, by what is said at the beginning of the bag."""
    try:
        with Bag(path) as bag:
            _, cloud = next(bag.raw_clouds(points))
            parents: dict[str, str] = {}
            for topic, time_ns, message in bag.transform_messages():
                if time_ns > bag.span_ns[0] + _EARLY_NS:
                    break
                if topic.endswith("tf_static"):
                    parents.update({t.child_frame_id: t.header.frame_id for t in message.transforms})
            return choose_base(str(cloud.header.frame_id), parents)
    except (InputError, StopIteration):
        return None


def _wants_base(given: Mapping[str, str]) -> bool:
    """Where the sensor's frame hangs below the base, a second parent for it would tear the tree."""
    is_sent = given["publish_tf"].strip().lower() == "true"
    return given["mode"] == "scan_matching" and is_sent and not given["base_frame"]
