"""The attribute tables of the documentation: names, units, ranges and defaults of the code."""

import re
from pathlib import Path

import pytest

from so101_motion.viam.published_models import MODELS

DOCS = Path(__file__).resolve().parents[3] / "docs"
HEAD = "| attribute | unit, range | default | |\n|---|---|---|---|\n"
OWN_WORDS = {"servo_voltage"}  # two of the numbers in its range are possible


def rows_of(model):
    """The cells of the model's table on its page, by attribute."""
    page = (DOCS / ("teleoperation.md" if model == "teleop" else "viam.md")).read_text()
    if model != "teleop":
        page = re.search(rf"^## `devrel:so101:{model}`\n(.*?)(?=^## |\Z)", page, re.M | re.S)[1]
    [table] = re.findall(re.escape(HEAD) + r"((?:^\|.*\n)+)", page, re.M)
    cells = [[cell.strip() for cell in row.split(" | ")] for row in table.splitlines()]
    return {row[0].strip("| `"): row[1:] for row in cells}


def form_of(each):
    """What the second column must say of an attribute; None if words of its own are needed."""
    if each.kind == "flag":
        return "true, false"
    if each.kind == "choice":
        return ", ".join(f"`{option}`" for option in each.options)
    if each.kind not in ("number", "whole") or each.name in OWN_WORDS:
        return None
    lower, upper = each.range
    span = f"{lower:.10g} to {upper:.10g}" if upper < 1e9 else ""
    return ", ".join(filter(None, (each.unit.replace("^2", "²"), span)))


def default_of(each):
    """What the third column must say of it; None if words of its own are needed."""
    if each.options:
        return f"`{each.options[0]}`"
    if isinstance(each.default, bool):
        return str(each.default).lower()
    return None if each.default is None else f"{each.default:.10g}"


@pytest.mark.parametrize("model", [each for each in MODELS if each != "simulated-gripper"])
def test_the_table_on_the_page_is_that_of_the_code(model):
    written = rows_of(model)
    assert list(written) == [each.name for each in MODELS[model].rows()]
    for each in MODELS[model].rows():
        form, default, use = written[each.name]
        assert form == (form_of(each) or form), each.name
        assert default == (default_of(each) or default) != "", each.name
        assert use.strip(" |"), each.name
