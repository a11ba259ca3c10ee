"""Options that several commands share, and the one place where preset, YAML and command line become a Config."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from svc_ros.core.config import AUTO, METHODS, PRESETS, Config, preset, unknown_name, with_values
from svc_ros.core.errors import ConfigError
from svc_ros.core.matches.descriptor_names import check_names

if TYPE_CHECKING:
    from svc_ros.core.auto_preset import Choice
    from svc_ros.core.scan import Scan
    from svc_ros.io.config_yaml import ConfigFile

DEFAULT_PRESET = AUTO

SourceArgument = Annotated[
    Path, typer.Argument(metavar="SOURCE", help="Scan to move (.bin .pcd .ply .npy .npz .las .e57 .xyz .csv ...).")
]
TargetArgument = Annotated[Path, typer.Argument(metavar="TARGET", help="Scan that stays; the pose is in its frame.")]
PresetOption = Annotated[
    str | None, typer.Option("--preset", metavar="NAME", help=f"{AUTO} (chosen from the scans), {', '.join(PRESETS)}.")
]
MethodOption = Annotated[
    str | None, typer.Option("--method", metavar="NAME", help=f"How poses are chosen and judged: {', '.join(METHODS)}.")
]
ConfigOption = Annotated[
    Path | None, typer.Option("--config", metavar="YAML", help="Values over the preset's; options win over the file.")
]
JsonOption = Annotated[
    str | None, typer.Option("--json", metavar="FILE", help="Write the result as JSON; - writes it to stdout, alone.")
]
FailOption = Annotated[
    bool, typer.Option("--fail-on-reject", help="Exit with 3 where the pose is not accepted.", show_default=False)
]
ColumnsOption = Annotated[
    str,
    typer.Option("--columns", metavar="NAMES", help="Of .bin and text files: x,y,z,intensity or float64,x,y,z ..."),
]
LimitOption = Annotated[int | None, typer.Option("--limit", min=1, metavar="N", help="First N of each kind only.")]
WorkersOption = Annotated[int, typer.Option("--workers", min=1, metavar="N", help="Processes that share the pairs.")]
SchedulerOption = Annotated[
    str | None,
    typer.Option("--scheduler", metavar="ADDRESS", help="Spread by Dask: local, or a scheduler's tcp://host:port."),
]
TopicOption = Annotated[str | None, typer.Option("--topic", metavar="TOPIC", help="Needed where several have clouds.")]
SensorOption = Annotated[
    str | None,
    typer.Option("--sensor-frame", metavar="FRAME", help="Sensor's frame, where the clouds are in another one."),
]
StrictOption = Annotated[bool, typer.Option("--strict", help="Refuse a damaged bag; else its intact part is read.")]
ReferenceFrameOption = Annotated[
    str | None,
    typer.Option("--reference-frame", metavar="FRAME", help="Whose poses these are; the clouds' frame by default."),
]


@dataclass(frozen=True)
class Settings:
    """A resolved configuration. preset: as it was named; choice: what `auto` chose, None for another preset."""

    preset: str
    config: Config
    choice: Choice | None = None

    @property
    def base(self) -> str:
        """The preset that the configuration started from; never `auto`."""
        return self.preset if self.choice is None else self.choice.preset

    def told(self) -> dict[str, Any]:
        """For a JSON result: `preset`, and where `auto` chose, `chosen` with its reason."""
        chosen = {} if self.choice is None else {"chosen": dict(self.choice.summary())}
        return {"preset": self.preset, **chosen}

    def shown(self) -> str:
        """The preset for a person."""
        return self.preset if self.choice is None else f"{self.preset}: {self.base}, {self.choice.why}"


@dataclass(frozen=True)
class Wanted:
    """What the user asked for, before anything is known about scans. values: of the command line."""

    preset: str
    values: Mapping[str, Any]
    file: ConfigFile | None = None

    @property
    def given(self) -> dict[str, Any]:
        """Dotted names that go over the preset, whichever it is."""
        return {**({} if self.file is None else self.file.values), **self.values}

    def over(self, base: Config) -> Config:
        """The whole configuration; ConfigError names the file."""
        return with_values(base if self.file is None else self.file.applied_to(base), self.values)

    def first_fit(self) -> Config:
        """The values over the first preset that may become theirs and that they go with; ConfigError if none is."""
        problems = []
        for base in PRESETS.values() if self.preset == AUTO else [preset(self.preset)]:
            try:
                return self.over(base)
            except ConfigError as error:
                problems.append(error)
        raise problems[0]

    def settle(self, choose: Callable[[], Choice] | None = None) -> Settings:
        """Decide on the preset. choose: asked where it is `auto`; None where there are no scans to choose by."""
        if self.preset != AUTO or choose is None:
            return Settings(self.preset, self.over(preset(self.preset)))
        choice = choose()
        return Settings(AUTO, self.over(choice.config), choice)


def read_wanted(
    preset_name: str | None, method: str | None, config_file: Path | None, default_preset: str = DEFAULT_PRESET
) -> Wanted:
    """What is asked for: the command line wins over the YAML file, the file over the preset.

    The preset itself is that of the command line, else the file's, else the default. Raises ConfigError for unknown
    names, values that fit no preset and descriptors that are not installed, InputError for a file that cannot be read.
    """
    values: dict[str, Any] = {} if method is None else {"method": method}
    file = None
    if config_file is not None:
        from svc_ros.io.config_yaml import read_config_file

        file = read_config_file(config_file)
    name = preset_name or (file and file.preset) or default_preset
    if name not in (*PRESETS, AUTO):
        problem = unknown_name("preset", name, [*PRESETS, AUTO])
        raise ConfigError(problem if preset_name else f"{config_file}: {problem}")
    wanted = Wanted(name, values, file)
    check_names(wanted.first_fit().matching.more_descriptors)
    return wanted


def choose_from(scans: Sequence[Scan]) -> Choice:
    """What `auto` makes of scans."""
    from svc_ros.core.auto_preset import choose_preset

    return choose_preset(scans)
