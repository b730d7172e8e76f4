"""A machine's configuration of the published module, taken over."""

import json
from pathlib import Path

import pytest

from so101_motion.common.errors import ConfigError
from so101_motion.viam import migration
from so101_motion.viam.migration import PUBLISHED, Outcome, migrate
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


def fates(found):
    return {row.attribute: row.outcome for row in found.rows if row.outcome is not Outcome.NEW}


@pytest.mark.parametrize("model", MODELS)
def test_the_table_knows_the_attributes_that_the_models_take(model):
    with pytest.raises(ConfigError) as caught:
        MODELS[model].config.from_attributes({"no such attribute": 1})
    listed = str(caught.value).partition("known: ")[2]
    assert set(filter(None, listed.split(", "))) == set(MODELS[model].names)


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
    assert fates(arm) == {
        "port": Outcome.KEPT,
        "timeout": Outcome.KEPT,
        "mesh_decimation_ratios": Outcome.IDLE,
        "spped": Outcome.UNSUPPORTED,
    }
    rows = {row.attribute: row for row in arm.rows}
    assert rows["timeout"].here.startswith("5 s")
    assert "speed_degs_per_sec" in rows["spped"].here
    assert rows["floor_z_mm"].outcome is Outcome.NEW
    assert not arm.problem
    assert arm.config["attributes"] == {
        "port": "/dev/a", "timeout": 5_000_000_000, "mesh_decimation_ratios": [0.5],
        "joint_zero": "middle",
    }  # fmt: skip
    assert arm.config["frame"] == {"parent": "world"}
    assert arm.config["name"] == "it"


def test_what_another_model_has_is_left_out_without_a_suggestion():
    given = {"port": "/dev/a", "servo_id": 6, "leader_arm": "one", "note": "mine"}
    (arm,) = migrate(part("devrel:so101:arm", given)).parts
    rows = {row.attribute: row for row in arm.rows}
    for name in ("servo_id", "leader_arm", "note"):
        assert rows[name].outcome is Outcome.UNSUPPORTED
        assert "ignored if it stays" in rows[name].here
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
    assert any(f'"joint_zero": "{zero}" is added' in line for line in found.differences)
    assert "joint_zero" not in migrate(arm).parts[0].config["attributes"]


def test_nothing_secret_is_reported():
    found = migrate(machine(part("devrel:so101:arm", {"port": "/dev/a", "token": "a secret"})))
    told = repr(found) + json.dumps(found.configuration()) + repr(found.steps_back())
    for secret in ("TOPSECRET", "HIDDEN", "PASSWORD", "a secret"):
        assert secret not in told


def test_both_generations_of_the_gripper_are_understood():
    older = part("devrel:so101:gripper", {"port": "/dev/a", "servo_id": 6}, "old")
    newer = part("devrel:so101:gripper", {"arm": "arm"}, "new")
    for found in migrate(machine(older, newer)).parts:
        assert not found.problem
        assert set(fates(found).values()) == {Outcome.KEPT}


def test_an_invalid_value_is_wrong():
    (found,) = migrate(machine(part("devrel:so101:gripper", {"arm": "a", "servo_id": 9}))).parts
    assert fates(found)["servo_id"] is Outcome.WRONG
    assert "1 to 6" in found.problem


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


def test_a_model_that_is_not_here_is_named_with_the_nearest():
    (found,) = migrate(machine(part("devrel:so101:simulatd", {}))).parts
    assert 'did you mean "simulated"' in found.problem


def test_the_way_back_holds_the_old_entry_and_what_to_take_out():
    entry = part("devrel:so101:arm", {"port": "/dev/a", "floor_z_mm": 0.0})
    back = "\n".join(migrate(machine(entry)).steps_back())
    assert '"version": "0.1.5"' in back
    assert "take out the attributes that only this module knows: floor_z_mm" in back


def test_the_module_keeps_its_name_for_its_data():
    found = migrate(machine(part("devrel:so101:arm", {"port": "/dev/a"})))
    (module,) = found.configuration()["modules"]
    assert module["name"] == "arms"
    assert module["type"] == "local"


def test_a_calibration_file_that_is_here_is_checked(tmp_path, monkeypatch):
    monkeypatch.delenv("VIAM_MODULE_DATA", raising=False)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "bad.json").write_text('{"elbow_flex": {"id": "three"}}')
    (tmp_path / "good.json").write_text(
        '{"elbow_flex": {"id": 3, "drive_mode": 0, "homing_offset": 12, "range_min": 900,'
        ' "range_max": 3000}}'
    )
    told = {}
    for name in ("bad.json", "good.json", "none.json", "/nowhere/none.json"):
        entry = part("devrel:so101:arm", {"port": "/dev/a", "calibration_file": name})
        told[name] = migrate(machine(entry)).parts[0].calibration
    assert "cannot be used" in told["bad.json"]
    assert "is good: 1 joints" in told["good.json"]
    assert "directory of the module's data" in told["none.json"]
    assert "run this there" in told["/nowhere/none.json"]


def on_port(model, name, file, port="/dev/a", **more):
    named = {} if file is None else {"calibration_file": file}
    return part(f"devrel:so101:{model}", {"port": port, **named, **more}, name)


def about_files(*components):
    notes = migrate(machine(*components)).notes
    return [note for note in notes if "different calibration files" in note]


def test_a_port_whose_components_name_different_files_is_told():
    arm, sensor = on_port("arm", "left", "a.json"), on_port("calibration", "sensor", "b.json")
    (note,) = about_files(
        sensor, arm, on_port("arm", "right", "a.json", "/dev/b"), on_port("gripper", "hand", None)
    )
    assert "/dev/a name different calibration files: sensor b.json, left a.json" in note
    assert "a.json, the arm's, is used for all" in note
    assert "the same calibration_file" in note
    (note,) = about_files(sensor, on_port("gripper", "hand", "c.json"))
    assert "b.json, or the first that is loaded, is used" in note


@pytest.mark.parametrize(
    "other",
    [
        on_port("calibration", "sensor", "a.json"),
        on_port("calibration", "sensor", None),
        on_port("calibration", "sensor", "b.json", "/dev/b"),
        on_port("gripper", "hand", "b.json", arm="left"),  # it has the arm's
    ],
)
def test_files_that_do_not_differ_are_not_told(other):
    assert not about_files(on_port("arm", "left", "a.json"), other)


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
