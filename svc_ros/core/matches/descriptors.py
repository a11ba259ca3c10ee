"""Descriptors beside FPFH: built-in ones and those of installed packages, and the matches that they give.

Each is a function that describes one scan (see `Descriptor`). It is imported when a configuration first names it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Hashable
from functools import lru_cache
from typing import Any, Protocol, cast

import numpy as np

from svc_ros.core.config import Config, FeatureConfig
from svc_ros.core.errors import ConfigError, DescriptorError, MissingDependencyError, SvcError
from svc_ros.core.matches.descriptor_names import find_descriptor, owner_of, split_names
from svc_ros.core.matches.features import compute_features
from svc_ros.core.matches.matching import match
from svc_ros.core.scan import Correspondences, Description, PreparedScan

_WIDE = 2.4  # radius of the wide FPFH, in radii of the ordinary one


class Descriptor(Protocol):
    """What an entry point of the group `svc_ros.descriptors` refers to: any callable like this.

    It describes places of one scan by vectors that are alike where places are. It gets the scan after range crop and
    voxel grid, and may choose places as it likes. It must not change the scan, and must give the same for the same.
    """

    def __call__(self, scan: PreparedScan, config: Config, /) -> Description: ...


def load_descriptors(config: Config) -> dict[str, Descriptor]:
    """The functions that `matching.more_descriptors` names, in its order; imported on first use.

    Raises ConfigError for unknown names and for what is no function, MissingDependencyError where an import fails.
    """
    return {name: _load(name) for name in split_names(config.matching.more_descriptors)}


def more_matches(source: PreparedScan, target: PreparedScan, config: Config) -> list[Correspondences]:
    """What the descriptors of `matching.more_descriptors` match, a set each, in their order; often none at all.

    Matched as FPFH is (`matching.strategy`, at most `matching.max_correspondences`). Descriptions are kept with the
    scan. Raises DescriptorError, naming the descriptor, for whatever goes wrong in it; `load_descriptors` tells others.
    """
    return [
        match(*_describe_both(name, descriptor, (source, target), config), config.matching)
        for name, descriptor in load_descriptors(config).items()
    ]


def forget_trees(scan: PreparedScan) -> None:
    """Give back the memory of all that is kept with a scan, but for its descriptions: a learned one takes long."""
    kept = {key: value for key, value in scan.memo.items() if isinstance(key, tuple) and key[0] == "description"}
    scan.memo.clear()
    for _, description in kept.values():
        description.memo.clear()
    scan.memo.update(kept)


def shared_descriptions(scan: PreparedScan) -> dict[Hashable, Any]:
    """A memo with the descriptions that are kept with a scan, their own search structures still to be built."""
    kept = ((key, value) for key, value in scan.memo.items() if isinstance(key, tuple) and key[0] == "description")
    return {key: (config, dataclasses.replace(description, memo={})) for key, (config, description) in kept}


def describe_by_wide_fpfh(scan: PreparedScan, config: Config) -> Description:
    """FPFH of 2.4 times the radius, with as many times the neighbours, lest they fill none of it: `fpfh_wide`."""
    most = {f.name: f.metadata["high"] for f in dataclasses.fields(FeatureConfig)}
    radius = min(_WIDE * config.features.radius_voxels, most["radius_voxels"])
    neighbours = min(round(_WIDE * config.features.max_neighbours), most["max_neighbours"])
    wide = dataclasses.replace(config, features=FeatureConfig(radius, neighbours))
    return Description(scan.points, compute_features(scan, wide).descriptors)


@lru_cache
def _load(name: str) -> Descriptor:
    point = find_descriptor(name)
    label = f"descriptor {name!r} of {owner_of(point)}: {point.value}"
    try:
        loaded = point.load()
    except ImportError as error:
        raise MissingDependencyError(f"{label} cannot be imported: {error}") from error
    except Exception as error:
        raise ConfigError(f"{label} cannot be loaded: {type(error).__name__}: {error}") from error
    if not callable(loaded):
        raise ConfigError(f"{label}: expected a function of a scan and a configuration, found {loaded!r:.80}")
    return cast(Descriptor, loaded)


def _describe_both(
    name: str, descriptor: Descriptor, scans: tuple[PreparedScan, PreparedScan], config: Config
) -> tuple[Description, Description]:
    source, target = (_described(name, descriptor, scan, config) for scan in scans)
    columns = [description.descriptors.shape[1] for description in (source, target)]
    if columns[0] != columns[1]:
        raise _failure(name, f"expected descriptors of one length, found {columns[0]} and {columns[1]} of two scans")
    return source, target


def _described(name: str, descriptor: Descriptor, scan: PreparedScan, config: Config) -> Description:
    """The description that is kept with the scan, as long as it is of this configuration; else a new one."""
    key = ("description", name)
    kept = scan.memo.get(key)
    if kept is None or kept[0] != config:
        kept = config, _checked(name, descriptor, scan, config)
        scan.memo[key] = kept
    return cast(Description, kept[1])


def _checked(name: str, descriptor: Descriptor, scan: PreparedScan, config: Config) -> Description:
    """A description of our own, nothing of which its maker can change any more, with rows of unit length or zeros."""
    try:
        made = descriptor(scan, config)
    except SvcError as error:
        raise _failure(name, str(error)) from error
    except Exception as error:
        raise _failure(name, f"{type(error).__name__}: {error}") from error
    if not isinstance(made, Description):
        raise _failure(name, f"expected a Description, found {type(made).__name__}")
    if made.descriptors.shape[1] < 2:  # of one number only the sign would be left
        raise _failure(name, f"expected descriptors of 2 numbers or more, found shape {made.descriptors.shape}")
    lengths = np.linalg.norm(made.descriptors.astype(np.float64), axis=1, keepdims=True)
    unit = np.divide(made.descriptors, lengths, out=np.zeros(made.descriptors.shape), where=lengths > 0)
    return Description(made.keypoints.copy(), unit)


def _failure(name: str, what: str) -> DescriptorError:
    return DescriptorError(f"descriptor {name!r} of {owner_of(find_descriptor(name))}: {what}")
