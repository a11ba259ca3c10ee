"""A whole calibration: judge, choose what to demand, and register again what that demand would have refused."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

from svc_ros.core.config import Config, with_values
from svc_ros.core.errors import InputError
from svc_ros.evaluation.calibration.claims import JudgedPose, choose_claim, pair_scores, pairs_needed, surest_claim
from svc_ros.evaluation.calibration.summary import Goal, JudgedSet, Row, summarise_calibration
from svc_ros.evaluation.calibration.trials import MIN_PROBABILITY, REGISTER, Judged, Trial, judge_trials, make_trials
from svc_ros.evaluation.runner import ProgressCallback
from svc_ros.io.config_yaml import changes_to_yaml
from svc_ros.io.datasets import Dataset

REGISTER_AGAIN = "register_again"  # kind of a pose that is found where the first one found is not probable enough
_ROUNDS = 3  # what is found then may be wrong in turn, and call for more


@dataclass(frozen=True)
class CalibrationOptions:
    """goal: what to promise; register: whole registrations too; limit: first pairs of each kind; workers: processes."""

    goal: Goal
    register: bool = True
    limit: int | None = None
    workers: int = 1
    seed: int = 0


def calibrate(
    sets: Sequence[tuple[Dataset, Config]], options: CalibrationOptions, on_progress: ProgressCallback | None = None
) -> Row:
    """Judge right and wrong poses of data sets, each with its config, and choose the probability to demand.

    The same numbers in every run and with any number of workers. Raises InputError for a method that heeds no demanded
    probability, for goals outside (0, 1), and where no pair can be judged.
    """
    pairs_needed(options.goal.max_wrong_rate, options.goal.confidence)  # refuses goals before the work
    for dataset, config in sets:
        if config.method != "svc":
            expected = f"method svc, which alone heeds {MIN_PROBABILITY}"
            raise InputError(f"{dataset.name}: expected {expected}, found {config.method}")
    sets = _with_own_names(sets)
    trials = [make_trials(dataset, options.register, options.limit, options.seed) for dataset, _ in sets]
    judged = judge_trials(sets, trials, options.workers, on_progress)
    of_sets = [JudgedSet(d.name, t, j) for (d, _), t, j in zip(sets, trials, judged, strict=True)]
    _check_judged(of_sets)
    for _ in range(_ROUNDS):
        changed = _register_again(sets, of_sets, options, on_progress)
        if changed is None:
            break
        of_sets = changed
    return summarise_calibration(of_sets, options.goal)


def calibrated_yaml(summary: Row, preset_name: str, config: Config, comment: str) -> str:
    """The configuration with the chosen value, else the surest, as YAML that names what differs from the preset."""
    value = (summary["chosen"] or summary["surest"])["min_probability"]
    return changes_to_yaml(with_values(config, {MIN_PROBABILITY: value}), preset_name, [MIN_PROBABILITY], comment)


def _with_own_names(sets: Sequence[tuple[Dataset, Config]]) -> list[tuple[Dataset, Config]]:
    """Data sets of one name get a number: their pairs are not the same."""
    counts, named = Counter(dataset.name for dataset, _ in sets), []
    for k, (dataset, config) in enumerate(sets, 1):
        name = dataset.name if counts[dataset.name] == 1 else f"{dataset.name} ({k})"
        named.append((replace(dataset, name=name), config))
    return named


def _check_judged(of_sets: Sequence[JudgedSet]) -> None:
    if any(not pose.correct for one in of_sets for pose in one.poses):
        return
    errors = [judged.error for one in of_sets for judged in one.judged if judged.error]
    names = ", ".join(one.name for one in of_sets)
    num = sum(len(one.trials) for one in of_sets)
    why = f": {errors[0]}" if errors else ""
    raise InputError(f"{names}: expected pairs with wrong poses to judge, found none among {num} pairs{why}")


def _register_again(
    sets: Sequence[tuple[Dataset, Config]],
    of_sets: Sequence[JudgedSet],
    options: CalibrationOptions,
    on_progress: ProgressCallback | None,
) -> list[JudgedSet] | None:
    """What registrations find once the chosen probability is demanded; None where that accepts nothing wrong.

    A registration that is not accepted searches on, so a wrong pose may come up that was not seen before.
    """
    goal, poses = options.goal, [pose for one in of_sets for pose in one.poses]
    scores = list(pair_scores(poses).values())
    claim = choose_claim(scores, goal.max_wrong_rate, goal.confidence) or surest_claim(scores, goal.confidence)
    places = [
        [k for k, judged in enumerate(one.judged) if _refused_at(judged, claim.min_probability)] for one in of_sets
    ]
    trials = [[replace(one.trials[k], poses=()) for k in at] for one, at in zip(of_sets, places, strict=True)]
    if not any(trials):
        return None
    answers = judge_trials(sets, trials, options.workers, on_progress, claim.min_probability)
    found = [[_wrong(judged) for judged in of_set] for of_set in answers]
    if not any(wrong for of_set in found for wrong in of_set):
        return None
    return [_with_more(*values) for values in zip(of_sets, places, found, strict=True)]


def _refused_at(judged: Judged, min_probability: float) -> bool:
    """Whether the registration of a trial was accepted, and would not be at that demanded probability."""
    return any(p.kind == REGISTER and p.accepted and p.score < min_probability for p in judged.poses)


def _wrong(judged: Judged) -> tuple[JudgedPose, ...]:
    return tuple(replace(p, kind=REGISTER_AGAIN) for p in judged.poses if p.accepted and not p.correct)


def _with_more(one: JudgedSet, places: Sequence[int], more: Sequence[tuple[JudgedPose, ...]]) -> JudgedSet:
    added = dict(zip(places, more, strict=True))
    judged: list[Judged] = [replace(j, poses=j.poses + added.get(k, ())) for k, j in enumerate(one.judged)]
    trials: Sequence[Trial] = one.trials
    return replace(one, trials=trials, judged=judged)
