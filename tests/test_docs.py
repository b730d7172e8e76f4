"""Every code block of the README and of docs/ runs as shown, on the simulated arm."""

import contextlib
import importlib
import json
import re
import shlex
from pathlib import Path

import click
import pytest
from google.protobuf.struct_pb2 import Struct
from harness.clocks import hurry_simulated_arms
from viam.proto.app.robot import ComponentConfig

import so101_motion as so101
from so101_motion.cli.verbs import main
from so101_motion.drivers.emulator.faults import parse_fault
from so101_motion.viam.conversion.convert import to_result
from so101_motion.viam.models.registered import MODELS

ROOT = Path(__file__).parents[1]
SAMPLE = ROOT / "examples" / "machine.json"
HOW_DO_I = ROOT / "docs" / "how-do-i.md"
DATA_SETS = ROOT / "docs" / "datasets.md"
PAGES = [*sorted(ROOT.glob("*.md")), *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page, language):
    return re.findall(rf"```{language}\n(.*?)```", page.read_text(), flags=re.DOTALL)


def having(language):
    return [page for page in PAGES if blocks(page, language)]


def called(page):
    return str(page.relative_to(ROOT))


def shown_commands():
    """Every ``so101 …`` on any page, in a block or in a sentence, once."""
    lines = [
        line for page in PAGES for block in blocks(page, "console") for line in block.split("\n")
    ]
    shown = [re.search(r"^\$ (?:\S*/)?so101 (.*?)(?:\s+#.*)?$", line) for line in lines]
    named = [
        re.findall(r"`so101 ([a-z][^`…]+?)`", page.read_text())
        for page in PAGES
        if page.parent.name != "decisions"  # which name what went away, too
    ]
    return sorted({match[1] for match in shown if match}.union(*named))


@pytest.fixture
def hurried_arms(monkeypatch):
    over = hurry_simulated_arms(monkeypatch.setattr)
    yield
    over.set()


@pytest.mark.usefixtures("planning_process", "hurried_arms")
@pytest.mark.parametrize("page", having("python"), ids=called)
def test_the_python_examples_run(page, capsys, monkeypatch, tmp_path):
    """Those of "How do I", whatever their port, on a simulated arm, and each shows something."""
    monkeypatch.chdir(tmp_path if page in (HOW_DO_I, DATA_SETS) else ROOT)
    if page == DATA_SETS:
        data_sets = pytest.importorskip("harness.lerobot_data")
        data_sets.write_data_set(tmp_path / "pick", [data_sets.swing()])
    if page == HOW_DO_I:
        monkeypatch.setattr(so101, "open", lambda *_: so101.open_simulated(), raising=False)
    for block in blocks(page, "python"):
        exec(compile(block.replace("10_000", "20"), called(page), "exec"), {})
        assert page != HOW_DO_I or capsys.readouterr().out, block
    assert page == HOW_DO_I or capsys.readouterr().out


def resources(content):
    """The components and services of a machine's configuration."""
    content = json.loads(content)
    return [*content.get("components", []), *content.get("services", [])]


def test_the_sample_machine_has_every_model_once():
    models = [each["model"] for each in resources(SAMPLE.read_text())]
    assert sorted(models) == sorted(str(model.model) for model in MODELS)


@pytest.mark.parametrize("page", [*having("json"), SAMPLE], ids=called)
def test_the_machine_configurations_are_accepted(page):
    models = {str(model.model): model for model in MODELS}
    for block in [page.read_text()] if page is SAMPLE else blocks(page, "json"):
        for resource in resources(block):
            model = models[resource["model"]]
            assert str(model.api) == resource["api"]
            attributes = to_result(resource.get("attributes", {}))
            struct = Struct()
            struct.update(attributes)
            model.validate_config(ComponentConfig(name=resource["name"], attributes=struct))


def test_the_reference_lists_and_describes_every_public_name(monkeypatch):
    monkeypatch.syspath_prepend(ROOT / "docs")
    gaps_in = importlib.import_module("make_reference").gaps_in
    page = (ROOT / "docs" / "reference.md").read_text()
    assert list(gaps_in(page)) == []
    monkeypatch.setattr(so101.PlanRequest, "seed_of", property(lambda _: 0), raising=False)
    shortened = page.replace("::: so101_motion.planning.goals.ArcTo\n", "")
    assert list(gaps_in(shortened)) == [
        "ArcTo is not listed",
        "PlanRequest.seed_of has no docstring",
    ]


def test_the_functions_of_a_move_are_in_the_files_that_the_architecture_names():
    _, _, page = (ROOT / "docs" / "architecture.md").read_text().partition("## One move")
    walks = re.findall(r"^\|[^|]*\| `(\S+\.py)` \| ([^:|]*)", page, flags=re.MULTILINE)
    assert len(walks) > 30
    for file, functions in walks:
        code = (ROOT / "so101_motion" / file).read_text()
        for name in re.findall(r"`([\w.]+)`", functions):
            for part in name.split("."):
                assert re.search(rf"(class|def) {part}\b", code), (file, name)


def test_what_can_be_typed_into_the_emulator_is_understood():
    page = (ROOT / "docs" / "first-hour.md").read_text()
    table = page[page.index("| type | to |") :]
    for line in table.splitlines()[2:]:
        for typed in re.findall(r"`([^`]+)`", line.split("|")[1]):
            parse_fault(typed.removeprefix("end "), ends=typed.startswith("end "))


def test_the_tests_that_minimal_machines_run_exist():
    script = (ROOT / "tests" / "machines" / "try_machines.py").read_text()
    named = re.findall(r"(tests/\S+\.py)::(\w+)", script)
    assert named
    for file, test in named:
        assert f"def {test}(" in (ROOT / file).read_text(), (file, test)


def test_every_make_target_that_is_shown_exists():
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(), flags=re.MULTILINE)
    shown = re.findall(r"make (\w+)", " ".join(blocks(ROOT / "README.md", "console")))
    assert shown
    assert set(shown) <= set(targets)


@pytest.mark.parametrize("shown", shown_commands())
def test_every_command_that_is_shown_is_understood(shown):
    words = shlex.split(shown)
    command, context = main, click.Context(main, info_name="so101")
    while words and isinstance(command, click.Group):
        found = command.get_command(context, words[0])
        assert found is not None, f"no such verb: {words[0]}"
        command, context = found, click.Context(found, parent=context, info_name=words.pop(0))
    with contextlib.suppress(click.BadOptionUsage):  # a sentence may name an option without a value
        command.make_parser(context).parse_args(list(words))


@pytest.mark.parametrize("page", PAGES, ids=called)
def test_every_local_link_leads_somewhere(page):
    text = page.read_text()
    links = re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text)
    assert [link for link in links if not (page.parent / link).exists()] == []
    headings = re.sub(r"[^a-z0-9_\n]", "", text.lower())
    within = re.findall(r"\]\(#([^)]+)\)", text)
    assert [link for link in within if link.replace("-", "") not in headings] == []
