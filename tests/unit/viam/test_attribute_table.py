"""The attribute tables of the documentation are those of the code."""

import re
from pathlib import Path

import pytest

from so101_motion.viam.published_models import MODELS

DOCS = Path(__file__).resolve().parents[3] / "docs"
HEAD = "| attribute | unit, range | default | |\n|---|---|---|---|\n"
ELSEWHERE = {"teleop": "teleoperation.md", "simulated-gripper": ""}
"""Models whose table stands on another page than viam.md; the last has that of the gripper."""


def form(each):
    """What the second column says of an attribute."""
    if each.form:
        return each.form
    if each.kind == "flag":
        return "true, false"
    if each.kind == "choice":
        return ", ".join(f"`{option}`" for option in each.options)
    lower, upper = each.range
    span = f"{lower:.10g} to {upper:.10g}" if upper < 1e9 else ""
    return ", ".join(filter(None, (each.unit.replace("^2", "²"), span)))


def table_of(model):
    """The table that the documentation has to have."""
    rows = []
    for each in MODELS[model].rows():
        more = f"; [more]({each.link})" if each.link else ""
        default = f"`{each.without}`" if each.options else each.without
        rows.append(f"| `{each.name}` | {form(each)} | {default} | {each.use}{more} |\n")
    return HEAD + "".join(rows)


def section_of(model):
    if model in ELSEWHERE:
        return (DOCS / ELSEWHERE[model]).read_text()
    page = (DOCS / "viam.md").read_text()
    found = re.search(rf"^## `devrel:so101:{model}`\n(.*?)(?=^## |\Z)", page, re.M | re.S)
    return found[1]


@pytest.mark.parametrize("model", [each for each in MODELS if ELSEWHERE.get(each) != ""])
def test_the_table_on_the_page_is_that_of_the_code(model):
    tables = re.findall(r"(?:^\|.*\n)+", section_of(model), re.M)
    assert table_of(model) in tables, f"put this table there:\n{table_of(model)}"
