"""What tests read out of the pages (README.md, docs/): tables, blocks, commands, headings."""

from __future__ import annotations

import ast
import importlib.util
import re
import shlex
from pathlib import Path
from types import ModuleType

from places import PROJECT_ROOT

COMMANDS = ("register", "verify", "view", "evaluate", "calibrate", "replay", "map", "simulate", "config", "doctor")
FENCED = re.compile(r"^```(\w*)[^\n]*\n(.*?)^```$", re.MULTILINE | re.DOTALL)
README = (PROJECT_ROOT / "README.md").read_text("utf-8")
REFERENCE = (PROJECT_ROOT / "docs" / "reference.md").read_text("utf-8")
FOLDERS = (".", "docs", "benchmarks", "config")
PAGES = {  # every page that is there to be read, by its path
    path.relative_to(PROJECT_ROOT).as_posix(): path.read_text("utf-8")
    for folder in FOLDERS
    for path in sorted((PROJECT_ROOT / folder).glob("*.md"))
}


def rows(section: str, text: str = REFERENCE) -> list[list[str]]:
    """Cells of the one table between <!-- section --> and <!-- /section -->, without its head."""
    (found,) = re.findall(f"<!-- {section} -->\n(.*?)<!-- /{section} -->", text, re.DOTALL)
    lines = [line for line in found.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines[2:]]


def code(text: str) -> list[str]:
    """What stands between backticks."""
    return re.findall(r"`([^`]+)`", text)


def prose(text: str) -> str:
    """A page without its blocks."""
    return FENCED.sub("", text)


def blocks(text: str, *languages: str) -> list[str]:
    """Blocks of these languages; "" for those that name none."""
    return [block for language, block in FENCED.findall(text) if language in languages]


def shell_lines(text: str) -> list[str]:
    """Commands of the blocks, continued lines joined, without prompts."""
    joined = "\n".join(blocks(text, "", "sh")).replace("\\\n", " ")
    return [line.strip().removeprefix("$ ") for line in joined.splitlines()]


def invocations(text: str) -> list[list[str]]:
    """Words of every `svc_ros COMMAND ...` in the blocks."""
    lines = [command.strip() for line in shell_lines(text) for command in re.split(r";(?: do)?", line)]
    return [shlex.split(line)[1:] for line in lines if line.startswith("svc_ros ")]


def anchors(text: str) -> set[str]:
    """What links to this page may have behind the #."""
    headings = re.findall(r"^#+ (.+)$", prose(text), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading.lower()).replace(" ", "-") for heading in headings}


def node_defaults() -> dict[str, object]:
    """The node's own parameters, read without rclpy."""
    (path,) = PROJECT_ROOT.glob("svc_ros/**/parameters.py")
    tree = ast.parse(path.read_text("utf-8"))
    (settings,) = (n for n in tree.body if isinstance(n, ast.ClassDef) and n.name == "NodeSettings")
    return {n.target.id: ast.literal_eval(n.value) for n in settings.body if isinstance(n, ast.AnnAssign)}


def absolute(cell: str) -> str:
    """A topic's or service's name as the tables have it, with the node's name in place of ~."""
    name = cell.strip("`")
    return name.replace("~", "/svc_registration") if name.startswith("~") else "/" + name.lstrip("/")


def module_from(path: Path) -> ModuleType:
    """A script as a module."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module
