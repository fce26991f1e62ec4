"""The documentation says what is there: commands, options, links, examples, parameters and the scenarios' limits."""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import typer.main

from benchmarks.pages.scenario_page import END, LIMITS, limits_table
from visloc_companion.app.settings import core_settings
from visloc_companion.cli.main import app
from visloc_companion.cli.map import MANY
from visloc_companion.config import Config, load_config
from visloc_companion.errors import ConfigError, Reason
from visloc_companion.evaluate.cases import COLUMNS, TRUTH_COLUMNS
from visloc_companion.evaluate.clouds.cloud_cases import CLOUD_FIELDS, GROWTH, SIGMA_FIELDS, TRUTH_FIELDS
from visloc_companion.evaluate.gate import parse_gate
from visloc_companion.evaluate.images.image import POSE_FIELDS
from visloc_companion.sim.autopilots.autopilot_parameters import PREPARED
from visloc_companion.types import AutopilotKind, Mode

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([ROOT / "README.md", ROOT / "CHANGELOG.md", *DOCS.rglob("*.md"), *ROOT.glob("models/*.md")])
PAGES += sorted(ROOT.glob("reference_tiles/*.md"))
EXAMPLES = sorted((DOCS / "examples").glob("*.toml"))
PARAMETERS = {AutopilotKind.ARDUPILOT: "ardupilot", AutopilotKind.PX4: "px4"}
FILE_SUFFIXES = ("toml", "mcap")
SETTINGS = r"`((?:link|camera|map|localiser|worker|navigator|gnss|injection|journal|clock|status)\.[a-z_0-9]+)`"

COMMANDS: Any = typer.main.get_command(app)
COMMAND = re.compile(r"(?:\S*/)?visloc ((?:run|replay|sim|demo|web|doctor|calibrate|here|link-key|map|evaluate|train)\b.*)$")


def text_of(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def commands_of(page: Path) -> Iterator[list[str]]:
    """Every `visloc SUBCOMMAND ...` in a code block or in a code span."""
    text = text_of(page)
    blocks = re.findall(r"^```\w*\n(.*?)^```", text, re.MULTILINE | re.DOTALL)
    prose = re.sub(r"^```.*?^```", "", text, flags=re.MULTILINE | re.DOTALL)
    for code in [*(line for block in blocks for line in block.splitlines()), *re.findall(r"`([^`]+)`", prose)]:
        found = COMMAND.match(code)
        if found is not None:
            yield shlex.split(found.group(1), comments=True)


def command_and_arguments(words: list[str]) -> tuple[Any, list[str], str]:
    command: Any = COMMANDS
    path = "visloc"
    rest = list(words)
    while rest and hasattr(command, "commands") and rest[0] in command.commands:
        path += f" {rest[0]}"
        command = command.commands[rest.pop(0)]
    return command, rest, path


def every_command() -> list[tuple[str, list[str]]]:
    return [(page.relative_to(ROOT).as_posix(), words) for page in PAGES for words in commands_of(page)]


@pytest.mark.parametrize(
    ("page", "words"), every_command(), ids=lambda value: value if isinstance(value, str) else " ".join(value)
)
def test_commands_exist_with_these_options(page: str, words: list[str]) -> None:
    command, rest, path = command_and_arguments(words)
    assert page
    if hasattr(command, "commands"):
        assert not [word for word in rest if not word.startswith("-")], f"{path} has no subcommand {rest}"
    options: dict[str, Any] = {name: param for param in command.params for name in param.opts}
    n_positional = sum(1 for param in command.params if param.param_type_name == "argument")
    positional, k = 0, 0
    while k < len(rest):
        word, k = rest[k], k + 1
        if not word.startswith("-") or word[1:2].isdigit():  # a place south of the equator is no option
            positional += 1
            continue
        assert word in options, f"{path} has no option {word}"
        if options[word].is_flag or k >= len(rest):  # prose may name an option alone
            continue
        k += 1
        while word in MANY and k < len(rest) and not rest[k].startswith("-"):
            k += 1
    assert positional <= n_positional, f"{path} takes {n_positional} arguments: {rest}"


def test_the_documentation_names_every_command() -> None:
    named = {path for _, words in every_command() for path in [command_and_arguments(words)[2]]}
    expected = {
        "run",
        "replay",
        "sim",
        "demo",
        "web",
        "doctor",
        "calibrate",
        "here",
        "link-key",
        "map build",
        "map check",
        "map features",
        "map info",
        "evaluate image",
        "evaluate cloud",
        "train features",
        "train export",
    }
    assert {f"visloc {name}" for name in expected} <= named


def anchors_of(page: Path) -> set[str]:
    headings = re.findall(r"^#+ (.+)$", text_of(page), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_relative_links_resolve(page: Path) -> None:
    for target in re.findall(r"\]\(([^)\s]+)\)", text_of(page)):
        if "://" in target or target.startswith("mailto:"):
            continue
        name, _, anchor = target.partition("#")
        file = (page.parent / name).resolve() if name else page
        assert file.exists(), f"{target} does not exist"
        assert file.is_relative_to(ROOT)
        if anchor:
            assert anchor in anchors_of(file), f"{target}: no such heading"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_configuration_keys_exist(page: Path) -> None:
    sections = Config.model_fields
    for key in re.findall(SETTINGS, text_of(page)):
        section, _, name = key.partition(".")
        model: Any = sections[section].annotation
        if name not in FILE_SUFFIXES and name not in model.model_fields:
            assert parse_gate(f"{key}<=1"), f"{key} is neither a key of the configuration nor a figure"


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_examples_are_valid_and_tell_the_core_what_they_say(example: Path) -> None:
    config = load_config(example)
    settings = core_settings(config)
    assert settings.injection.policy == config.injection.policy
    assert config.navigator.output_rate_hz >= 10 or example.stem != "px4"
    assert f"docs/examples/{example.name}" in text_of(ROOT / "README.md") or f"examples/{example.name}" in text_of(
        DOCS / "on-a-drone.md"
    )


def test_a_wrong_key_in_an_example_would_be_found(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.toml"
    wrong.write_text(text_of(EXAMPLES[0]) + "\n[injektion]\n", encoding="utf-8")
    with pytest.raises(ConfigError, match="injection"):
        load_config(wrong)


def parameters_of(kind: AutopilotKind) -> dict[str, float]:
    found: dict[str, float] = {}
    for line in text_of(DOCS / "parameters" / f"{PARAMETERS[kind]}.parm").splitlines():
        if line.startswith("#"):
            continue
        words = line.split(",") if kind is AutopilotKind.ARDUPILOT else line.split("\t")[2:4]
        name, value = words
        assert name not in found
        found[name] = float(value)
    return found


@pytest.mark.parametrize("kind", PARAMETERS)
def test_parameter_files_hold_known_names_with_the_values_that_were_flown(kind: AutopilotKind) -> None:
    chosen_apart = {"VISO_POS_M_NSE"}  # the page gives the reason
    later = {"ARMING_SKIPCHK"}  # the version that was flown does not have it yet
    for name, value in parameters_of(kind).items():
        if name in later:
            continue
        assert name in PREPARED[kind], f"{name} is no parameter that the simulated autopilot knows"
        assert name in chosen_apart or value == PREPARED[kind][name]


@pytest.mark.parametrize("kind", PARAMETERS)
def test_pages_state_the_values_of_the_parameter_files(kind: AutopilotKind) -> None:
    stated: dict[str, float] = {}
    page = text_of(DOCS / f"{PARAMETERS[kind]}.md")
    for names, values in re.findall(r"^\| ((?:`[A-Z0-9_]+` ?)+)\| ([\d. ]+) \|", page, re.MULTILINE):
        tails = re.findall(r"`([A-Z0-9_]+)`", names)
        prefix = tails[0].rpartition("_")[0]
        full = [tails[0], *(f"{prefix}_{tail}" for tail in tails[1:])]
        stated |= dict(zip(full, (float(value) for value in values.split()), strict=True))
    assert stated == parameters_of(kind)


def test_what_is_not_checked_before_arming_is_the_same_by_both_names() -> None:
    """ARMING_CHECK has the checks that are done (bits 1 to 19), ARMING_SKIPCHK those that are left out."""
    told = parameters_of(AutopilotKind.ARDUPILOT)
    every = sum(1 << bit for bit in range(1, 20))
    assert every - int(told["ARMING_CHECK"]) == int(told["ARMING_SKIPCHK"]) == 1 << 18


def test_px4_types_are_those_that_qgroundcontrol_reads() -> None:
    int32, real32 = "6", "9"
    for line in text_of(DOCS / "parameters" / "px4.parm").splitlines():
        if line.startswith("#"):
            continue
        vehicle, component, name, _, kind = line.split("\t")
        assert (vehicle, component) == ("1", "1")
        assert kind == (real32 if "DELAY" in name or "TAU" in name else int32)


def test_the_floor_of_the_covariance_is_the_one_that_the_daemon_claims() -> None:
    assert parameters_of(AutopilotKind.ARDUPILOT)["VISO_POS_M_NSE"] == Config().injection.min_sigma_m


def test_the_table_of_scenarios_states_their_limits() -> None:
    page = text_of(DOCS / "scenarios.md")
    stated = page.split(LIMITS)[1].split(END)[0].strip()
    assert stated == limits_table(), "python -m benchmarks.scenarios --write docs/scenarios.md"


def test_reasons_and_modes_that_are_explained_exist() -> None:
    section = text_of(DOCS / "troubleshooting.md").split("## No fixes")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ((?:`[a-z_]+`(?:, )?)+) \|", section, re.MULTILINE)
    named = {name for row in rows for name in re.findall(r"`([a-z_]+)`", row)}
    assert named
    assert named <= {reason.value for reason in Reason}
    for mode in Mode:
        assert f"| {mode.value.upper()} |" in text_of(DOCS / "mavlink.md")


def test_columns_and_gates_that_are_named_exist() -> None:
    page = text_of(DOCS / "replay.md")
    assert ", ".join(COLUMNS) in page.replace("\n", " ").replace("  ", " ")
    assert ", ".join(TRUTH_COLUMNS) in page
    for gate in re.findall(r'--gate "([^"]+)"', page + text_of(ROOT / "README.md")):
        assert parse_gate(gate)
    section = page.split("`--gate` takes")[1].split("dotted paths")[0]
    for name in re.findall(r"\b[a-z]+[a-z0-9]*_[a-z0-9_]+\b|\bhmi\b|\bnees\b", section):
        assert parse_gate(f"{name}<=1")


def test_every_field_of_an_answer_is_described() -> None:
    page = text_of(DOCS / "replay.md").split("## Image cases")[1]
    assert [field for field in ("id", "status", "reason", *POSE_FIELDS, "elapsed_ms") if f"`{field}`" not in page] == []


def test_every_field_of_cloud_cases_is_described() -> None:
    page = text_of(DOCS / "structure.md")
    assert all(f"`{field}`" in page for field in (*CLOUD_FIELDS, *SIGMA_FIELDS, *TRUTH_FIELDS, GROWTH))


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.relative_to(ROOT).as_posix())
def test_no_path_of_one_machine(page: Path) -> None:
    assert not re.search(r"/(?:work|root|home/[a-z]+)/", text_of(page))
