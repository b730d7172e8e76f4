"""A machine's configuration of the published module, taken over; meta.json; tables in docs."""

import json
import os
import re
from pathlib import Path

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.viam import migration
from so101_motion.viam.migration import PUBLISHED, migrate
from so101_motion.viam.models.registered import MODELS as REGISTERED
from so101_motion.viam.published_models import MODELS

ROOT = Path(__file__).parents[3]


def machine(*components, **more):
    return {
        "cloud": {"id": "x", "secret": "TOPSECRET"},
        "modules": [
            {
                "type": "registry",
                "name": "arms",
                "module_id": PUBLISHED,
                "version": "0.1.5",
                "env": {"KEY": "HIDDEN"},
            }
        ],
        "components": [
            {"name": "cam", "model": "viam:camera:x", "attributes": {"password": "PASSWORD"}},
            *components,
        ],
        **more,
    }


def part(model, attributes, name="it", **more):
    api = "rdk:component:arm"
    return {"name": name, "api": api, "model": model, "attributes": attributes, **more}


def test_what_is_known_stays_and_what_is_not_is_named():
    found = migrate(
        machine(
            part(
                "devrel:so101:arm",
                {"port": "/dev/a", "timeout": 5_000_000_000, "mesh_decimation_ratios": [0.5],
                 "spped": "a secret"},
                frame={"parent": "world"},
            )
        )
    )  # fmt: skip
    (arm,) = found.parts
    told = "\n".join(arm.notes)
    assert '"mesh_decimation_ratios": ' in told
    assert '"spped" is no attribute of this model: left out; did you mean "speed_degs' in told
    assert not arm.problem
    assert arm.config["attributes"] == {
        "port": "/dev/a", "timeout": 5_000_000_000, "mesh_decimation_ratios": [0.5],
        "joint_zero": "middle",
    }  # fmt: skip
    assert arm.config["frame"] == {"parent": "world"}
    assert arm.config["name"] == "it"
    others = {"port": "/dev/a", "servo_id": 6, "leader_arm": "one", "note": "mine"}
    (arm,) = migrate(part("devrel:so101:arm", others)).parts  # what another model has
    assert [line.endswith("ignored if it stays") for line in arm.notes] == [True] * 3
    assert arm.config["attributes"] == {"port": "/dev/a"}


@pytest.mark.parametrize(
    ("version", "zero"),
    [("0.8.0", "middle"), ("0.9.0-rc2", "middle"), ("0.9.0-rc3", "homing"), ("0.9.0", "homing"),
     ("v1.0.0", "homing"), ("latest", "homing"), (None, "homing")],
)  # fmt: skip
def test_the_zero_of_joints_is_that_of_the_version_in_use(version, zero):
    arm = part("devrel:so101:arm", {"port": "/dev/a"})
    content = machine(arm)
    content["modules"][0]["version"] = version
    (found,) = migrate(content).parts
    assert found.config["attributes"]["joint_zero"] == zero
    assert any(f'"joint_zero": "{zero}" is added' in line for line in found.notes)
    assert "joint_zero" not in migrate(arm).parts[0].config["attributes"]


@pytest.mark.parametrize(
    ("model", "attributes", "problem"),
    [
        ("gripper", {"port": "/dev/a", "servo_id": 6}, ""),  # of the older generation
        ("gripper", {"arm": "arm"}, ""),  # of the newer
        ("gripper", {"arm": "a", "servo_id": 9}, "1 to 6"),
        ("simulatd", {}, 'did you mean "simulated"'),
    ],
)
def test_what_cannot_be_used_as_it_is_has_a_problem(model, attributes, problem):
    (found,) = migrate(machine(part(f"devrel:so101:{model}", attributes))).parts
    assert problem in found.problem
    assert bool(problem) == bool(found.problem)
    assert found.notes == ()


def test_an_old_spelling_of_models_and_apis_is_read():
    entry = {
        "name": "arm",
        "namespace": "rdk",
        "type": "arm",
        "model": {"namespace": "devrel", "model_family": "so101", "name": "simulated"},
    }
    (found,) = migrate(entry | {"attributes": {}}).parts
    assert found.config["api"] == "rdk:component:arm"
    assert found.config["model"] == "devrel:so101:simulated"


def test_the_way_back_says_what_to_take_out():
    entry = part("devrel:so101:arm", {"port": "/dev/a", "floor_z_mm": 0.0})
    found = migrate(machine(entry))
    (module,) = found.configuration()["modules"]
    assert (module["name"], module["type"]) == ("arms", "local"), "its data has that name"
    assert "to go back, take out what only this module knows: floor_z_mm, joint_zero" in found.notes


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ("text", "must be a JSON object"),
        ({"components": []}, "nothing to migrate"),
        ({"components": "none"}, "nothing to migrate"),
        ({"fragments": ["x"]}, "fragments"),
        ([{"model": None}, 3], "nothing to migrate"),
    ],
)
def test_what_has_nothing_to_take_over_is_refused_in_a_sentence(content, says):
    with pytest.raises(ConfigError, match=says):
        migrate(content)


def test_the_sample_configuration_goes_through_unchanged():
    sample = json.loads((ROOT / "examples" / "machine.json").read_text())
    found = migrate(sample)
    assert not any(one.problem for one in found.parts)
    again = found.configuration()
    for kind in ("components", "services"):
        assert [entry["name"] for entry in again[kind]] == [e["name"] for e in sample[kind]]
        for entry, before in zip(again[kind], sample[kind], strict=True):
            assert entry == {"attributes": {}, **before}
    assert migration.FAMILY == "devrel:so101:"


META = json.loads((ROOT / "meta.json").read_text())


def test_the_published_models_are_the_registered_ones_and_have_their_texts():
    listed = {(model["api"], model["model"]) for model in META["models"]}
    registered = {(str(model.api), str(model.model)) for model in REGISTERED}

    assert listed == registered
    assert len(META["models"]) == len(REGISTERED)
    links = [META["markdown_link"], *(model["markdown_link"] for model in META["models"])]
    assert all((ROOT / link).is_file() for link in links)


@pytest.mark.parametrize("key", ["entrypoint", "first_run"])
def test_what_viam_server_runs_is_there_and_executable(key):
    assert os.access(ROOT / META[key], os.X_OK)


HEAD = "| attribute | unit, range | default | |\n|---|---|---|---|\n"
OWN_WORDS = {"servo_voltage"}  # two of the numbers in its range are possible


def rows_of(model):
    """The cells of the model's table on its page, by attribute."""
    page = (ROOT / "docs" / ("teleoperation.md" if model == "teleop" else "viam.md")).read_text()
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
