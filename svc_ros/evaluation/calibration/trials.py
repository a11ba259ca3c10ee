"""The work of a calibration: every pair with its poses to judge is a unit of work, for one process or several."""

from __future__ import annotations

import uuid
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from svc_ros.core import registration
from svc_ros.core.config import Config, with_values
from svc_ros.core.errors import InputError, TooFewPointsError
from svc_ros.core.result import RegistrationResult
from svc_ros.core.scan import Array, Features, PreparedScan
from svc_ros.core.se3 import pose_error
from svc_ros.evaluation.calibration.claims import LOWEST, JudgedPose
from svc_ros.evaluation.evaluator import Evaluator, without_pairs
from svc_ros.evaluation.runner import ProgressCallback, crew_of
from svc_ros.evaluation.wrong_poses import (
    CORRECT,
    GREY,
    REFERENCE,
    WRONG,
    label_of,
    poses_of_negative,
    poses_of_pair,
)
from svc_ros.io.datasets import Candidate, Dataset, Pair
from svc_ros.pipeline.decide import register_pair

REGISTER = "register"  # kind of a pose that was found, not given
MIN_PROBABILITY = "decision.min_probability"

_CHUNK = 2  # neighbours in the list share scans, and a bar that moves is nicer


@dataclass(frozen=True, eq=False)
class Trial:
    """One pair, the poses to judge on it, and whether it is registered too.

    pair: its T_target_source is None where nothing tells which pose is right; then what `register` finds is wrong,
    and given poses keep their labels.
    """

    pair: Pair
    poses: tuple[Candidate, ...]
    register: bool

    @property
    def name(self) -> str:
        """The same for both directions."""
        return " - ".join(sorted((self.pair.source, self.pair.target)))


@dataclass(frozen=True)
class Judged:
    """What came of a trial. num_grey: poses that are neither right nor wrong, and are left out; error: why the scans
    cannot be judged at all, "" where they can."""

    poses: tuple[JudgedPose, ...]
    num_grey: int = 0
    error: str = ""


@dataclass(frozen=True, eq=False)
class _Chunk:
    """Some trials of one data set as they travel; run: a name of this run and data set."""

    run: str
    dataset: Dataset
    config: Config
    trials: tuple[Trial, ...]


def make_trials(dataset: Dataset, register: bool, limit: int | None = None, seed: int = 0) -> list[Trial]:
    """Every pair with its reference and wrong poses made from it, every negative, and the poses of candidates.json.

    The first `limit` of each kind only. Raises InputError for a pair without its reference.
    """
    pairs, negatives = dataset.pairs[:limit], dataset.negatives[:limit]
    known = [_known(dataset, pair) for pair in pairs]
    given = _given_poses(dataset, limit)
    trials = []
    for k, (pair, T) in enumerate(zip(pairs, known, strict=True)):
        others = [*known[:k], *known[k + 1 :]]
        made = poses_of_pair(T, others, dataset.success, np.random.default_rng([seed, 0, k]))
        trials.append(Trial(pair, made + given.pop((pair.source, pair.target), ()), register))
    for k, pair in enumerate(negatives):
        made = poses_of_negative(pair.T_target_source, known, dataset.success, np.random.default_rng([seed, 1, k]))
        trials.append(Trial(pair, made, register))
    return trials + [Trial(_pair_of(names, poses), poses, False) for names, poses in given.items()]


def judge_trials(
    sets: Sequence[tuple[Dataset, Config]],
    trials: Sequence[Sequence[Trial]],
    workers: int = 1,
    on_progress: ProgressCallback | None = None,
    min_probability: float = LOWEST,
) -> list[list[Judged]]:
    """Judge the poses of every trial, with the ranges of its data set; one list a data set, in its order.

    The same whatever the number of processes. on_progress: (done, total) in trials; min_probability: in force
    meanwhile, its lowest value hides no probability of what is accepted. Raises InputError naming the pair whose files
    cannot be read; scans with too few points are told by `Judged.error`.
    """
    opened = [(dataset, _opened(dataset, config, min_probability)) for dataset, config in sets]
    chunks = [chunk for given, of_set in zip(opened, trials, strict=True) for chunk in _chunks(given, of_set)]
    total, done = sum(map(len, trials)), 0

    def count(index: int, _: object) -> None:
        nonlocal done
        done += len(chunks[index].trials)
        if on_progress is not None:
            on_progress(done, total)

    try:
        answers = crew_of(workers, len(chunks))(judge_chunk, chunks, count)
    finally:
        _resident.clear()
    judged = iter([one for of_chunk in answers for one in of_chunk])
    return [[next(judged) for _ in of_set] for of_set in trials]


_resident: dict[str, _Judge] = {}


def judge_chunk(chunk: _Chunk) -> list[Judged]:
    """All trials of a chunk. Scans stay for the next chunk of the same run, in this process."""
    if chunk.run not in _resident:
        _resident.clear()
        _resident[chunk.run] = _Judge(chunk.dataset, chunk.config)
    return [_resident[chunk.run].judge(trial) for trial in chunk.trials]


class _Judge(Evaluator):
    """Judges the trials of one data set, each scan prepared once."""

    def judge(self, trial: Trial) -> Judged:
        """Every pose of one trial."""
        try:
            answers = list(self._answers(trial))
        except TooFewPointsError as error:
            return Judged((), error=str(error))
        found = [self._judged(trial, *answer) for answer in answers]
        return Judged(tuple(pose for pose in found if pose is not None), sum(pose is None for pose in found))

    def _answers(self, trial: Trial) -> Iterator[tuple[RegistrationResult, str, str]]:
        """What each pose gets for an answer, how it was made, and its label."""
        source: PreparedScan | Features
        target: PreparedScan | Features
        if trial.register:
            source, target = described = self._both(trial.pair, self._features)
            yield register_pair(*described, self.config), REGISTER, WRONG
        else:
            source, target = self._both(trial.pair, self._prepared)
        for pose in trial.poses:
            yield registration.verify(source, target, pose.T_target_source, self.config), pose.origin, pose.label

    def _judged(self, trial: Trial, result: RegistrationResult, kind: str, label: str) -> JudgedPose | None:
        """The answer beside the truth; None for a grey pose. Judged is the pose as it came out of the refinement."""
        T, reference = result.best_candidate, trial.pair.T_target_source
        errors: tuple[float | None, float | None] = (None, None)
        if T is not None and reference is not None:
            label, errors = label_of(T, reference, self.dataset.success), pose_error(T, reference)
        if label == GREY:
            return None
        correct, probability = T is not None and label == CORRECT, None if T is None else result.probability
        return JudgedPose(self.dataset.name, trial.name, kind, correct, result.accepted, probability, *errors)


def _known(dataset: Dataset, pair: Pair) -> Array:
    if pair.T_target_source is None:
        place = f"{dataset.name}: pair {pair.source} -> {pair.target}"
        raise InputError(f"{place}: expected a reference T_target_source, found none")
    return pair.T_target_source


def _given_poses(dataset: Dataset, limit: int | None) -> dict[tuple[str, str], tuple[Candidate, ...]]:
    """The labelled poses that candidates.json has, without the grey ones, by source and target."""
    given: dict[tuple[str, str], tuple[Candidate, ...]] = {}
    for item in dataset.candidates[:limit]:
        poses = tuple(pose for pose in item.candidates if pose.label != GREY)
        given[item.source, item.target] = given.get((item.source, item.target), ()) + poses
    return given


def _pair_of(names: tuple[str, str], poses: Sequence[Candidate]) -> Pair:
    """A pair that dataset.json does not list; its reference is among its poses, or not known."""
    references = (pose.T_target_source for pose in poses if pose.label == CORRECT and pose.origin == REFERENCE)
    return Pair(*names, next(references, None))


def _chunks(given: tuple[Dataset, Config], trials: Sequence[Trial]) -> Iterator[_Chunk]:
    run, dataset = uuid.uuid4().hex, without_pairs(given[0])
    for k in range(0, len(trials), _CHUNK):
        yield _Chunk(run, dataset, given[1], tuple(trials[k : k + _CHUNK]))


def _opened(dataset: Dataset, config: Config, min_probability: float) -> Config:
    limits = {"preprocess.min_range_m": dataset.min_range_m, "preprocess.max_range_m": dataset.max_range_m}
    return with_values(config, {**limits, MIN_PROBABILITY: min_probability})
