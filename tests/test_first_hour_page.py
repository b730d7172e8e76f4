"""Every command on the page for newcomers exists."""

import re
import shlex
from pathlib import Path

import click
import pytest

from so101_motion.cli.verbs import main
from so101_motion.drivers.emulator.faults import parse_fault

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "first-hour.md").read_text()
SHOWN = re.findall(r"^\$ (.*)$", PAGE, flags=re.MULTILINE)
NAMED = re.findall(r"`(so101 [^`…]+?)`", PAGE)


def parse(line):
    """Let click read a command without running it."""
    name, *arguments = shlex.split(line)
    assert name == "so101"
    group, context = main, main.make_context("so101", arguments, resilient_parsing=False)
    while True:
        name, command, arguments = group.resolve_command(context, arguments)
        if not hasattr(command, "commands"):
            command.make_context(name, arguments, parent=context)
            return
        group, context = command, click.Context(command, parent=context, info_name=name)


@pytest.mark.parametrize("line", sorted(set(NAMED)))
def test_a_command_that_is_named_exists(line):
    verb = shlex.split(line)[1]
    assert verb in main.commands
    if " --" in line or len(shlex.split(line)) == 2:
        parse(line)


def test_what_is_not_ours_is_what_a_newcomer_may_type():
    others = [line for line in SHOWN if not line.startswith("so101 ")]
    assert others == [
        "./setup.sh --with viewer",
        ". .venv/bin/activate",
        "export SO101_PORT=/tmp/so101",
    ]
    assert (ROOT / "run.sh").exists()


def test_what_can_be_typed_into_the_emulator_is_understood():
    table = PAGE[PAGE.index("| type | to |") :]
    for line in table.splitlines()[2:]:
        for typed in re.findall(r"`([^`]+)`", line.split("|")[1]):
            parse_fault(typed.removeprefix("end "))


def test_every_local_link_of_the_page_leads_somewhere():
    for link in re.findall(r"\]\(#([^)]+)\)", PAGE):
        headings = re.sub(r"[^a-z0-9 \n]", "", PAGE.lower())
        assert link.replace("-", " ") in headings
