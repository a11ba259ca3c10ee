"""Links, pictures, commands, scripts and parameters of every page are there; its Python and data are sound."""

from __future__ import annotations

import re

import pytest
from command_line import run
from pages import COMMANDS, PAGES, anchors, blocks, code, invocations, prose, shell_lines
from places import PROJECT_ROOT

from svc_ros.core.config import preset, walk
from svc_ros.io.datasets import read_dataset

LINK = re.compile(r"\]\(([^)\s]+)\)")


def broken(page: str, text: str) -> list[str]:
    """Relative links and pictures of a page that lead nowhere."""
    found = []
    for target in LINK.findall(prose(text)):
        name, _, anchor = target.partition("#")
        if name.startswith(("http://", "https://")):
            continue
        path = (PROJECT_ROOT / page).parent / name if name else PROJECT_ROOT / page
        if not path.is_file() or (anchor and anchor not in anchors(path.read_text("utf-8"))):
            found.append(target)
    return found


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    assert broken(page, PAGES[page]) == []


def test_links_that_lead_nowhere_are_found():
    text = "[a](no.md) [b](#limits) [c](#no) [d](docs/frames.md#one-rule) [e](docs/frames.md#no) ![f](no.png)"
    assert broken("README.md", text) == ["no.md", "#no", "docs/frames.md#no", "no.png"]


@pytest.mark.parametrize("command", COMMANDS)
def test_commands_take_these_options(command):
    done = run(command, "--help")
    assert done.exit_code == 0, done.stderr
    used = [words for text in PAGES.values() for words in invocations(text) if words[0] == command]
    options = {word for words in used for word in words if word.startswith("--")}
    assert used
    assert {option for option in options if option not in done.stdout} == set()


@pytest.mark.parametrize("page", PAGES)
def test_commands_exist(page):
    assert {words[0] for words in invocations(PAGES[page])} <= {*COMMANDS, "COMMAND"}


@pytest.mark.parametrize("page", PAGES)
def test_make_targets_exist(page):
    targets = set(re.findall(r"^([\w-]+):", (PROJECT_ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    lines = "\n".join([*shell_lines(PAGES[page]), *code(prose(PAGES[page]))])
    assert set(re.findall(r"^make (?:-C \S+ )?([\w-]+)", lines, re.MULTILINE)) <= targets


@pytest.mark.parametrize("page", PAGES)
def test_modules_and_scripts_exist(page):
    for name in re.findall(r"python -m (svc_ros[\w.]*)", PAGES[page]):
        path = PROJECT_ROOT / name.replace(".", "/")
        assert path.with_suffix(".py").is_file() or (path / "__main__.py").is_file(), name
    for name in re.findall(r"python ((?:tools|benchmarks)/\S+?\.py)", PAGES[page]):
        assert (PROJECT_ROOT / name).is_file(), name


@pytest.mark.parametrize("page", [page for page in PAGES if not page.startswith("benchmarks/")])
def test_dotted_names_are_parameters(page):
    known = {info.name for info in walk(preset("lidar_outdoor"))}
    groups = {name.partition(".")[0] for name in known if "." in name}
    dotted = {name for name in code(prose(PAGES[page])) if re.fullmatch(r"\w+\.\w+", name)}
    assert {name for name in dotted if name.partition(".")[0] in groups} <= known


@pytest.mark.parametrize("page", PAGES)
def test_launch_commands_take_these_arguments(page):
    lines = [line for line in (*shell_lines(PAGES[page]), *code(prose(PAGES[page]))) if line.startswith("ros2 launch")]
    for words in map(str.split, lines):
        texts = [(PROJECT_ROOT / "launch" / name).read_text("utf-8") for name in {words[3], "registration.launch.py"}]
        declared = {name for text in texts for name in re.findall(r'^    "(\w+)": (?:\(|MODE,)', text, re.MULTILINE)}
        assert {word.partition(":=")[0] for word in words[4:] if ":=" in word} <= declared, words


@pytest.mark.parametrize("page", PAGES)
def test_python_compiles(page):
    for text in blocks(PAGES[page], "python"):
        compile(text, page, "exec")


def test_the_data_set_can_be_read(tmp_path):
    (text,) = re.findall(r"dataset.json <<'END'\n(.*?)^END$", PAGES["docs/benchmarks.md"], re.MULTILINE | re.DOTALL)
    folder = tmp_path / "try"
    folder.mkdir()
    (folder / "dataset.json").write_text(text)
    read = read_dataset(folder)
    assert (len(read.pairs), len(read.negatives)) == (1, 1)
