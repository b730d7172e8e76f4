"""``so101 viam import`` on files."""

import json

import pytest
from harness.command_line import refused

MACHINE = {
    "cloud": {"secret": "TOPSECRET"},
    "modules": [{"type": "registry", "name": "arms", "module_id": "devrel:so101-arm"}],
    "components": [
        {
            "name": "my-arm",
            "api": "rdk:component:arm",
            "model": "devrel:so101:arm",
            "attributes": {"port": "/dev/ttyUSB0", "spped": "HIDDEN"},
        }
    ],
}


@pytest.fixture
def run(so101):
    return lambda *words, given=None: so101("viam import", *words, input=given)


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "machine.json"
    path.write_text(json.dumps(MACHINE))
    return path


def test_a_configuration_is_printed_anew(run, file):
    before = file.read_bytes()
    result = run(str(file))
    assert result.exit_code == 0, result.output
    pasted = json.loads(result.stdout)
    assert pasted["components"][0]["name"] == "my-arm"
    assert pasted["components"][0]["attributes"] == {"port": "/dev/ttyUSB0", "joint_zero": "homing"}
    for words in ('note: my-arm: "spped"', "to go back"):
        assert words in result.stderr
    for secret in ("TOPSECRET", "HIDDEN"):
        assert secret not in result.output
    assert file.read_bytes() == before


def test_it_comes_from_stdin_and_goes_to_programs(run, file):
    result = run("-", "--json", given=file.read_text())
    told = json.loads(result.stdout)
    assert told["schema"] == "so101/viam-import/1"
    assert '"joint_zero": "homing" is added' in told["parts"][0]["notes"][1]
    assert told["configuration"]["components"][0]["model"] == "devrel:so101:arm"


def test_a_configuration_that_cannot_be_used_as_it_is_is_exit_code_6(run, file):
    broken = json.loads(file.read_text())
    broken["components"][0]["attributes"]["speed_degs_per_sec"] = 900
    file.write_text(json.dumps(broken))
    assert "3 to 180" in refused(run(str(file)), 6)


@pytest.mark.parametrize(
    ("given", "says"),
    [("{", "is not JSON"), ("[" * 100_000, "is not JSON"), ("[1]", "nothing to migrate")],
)
def test_an_invalid_configuration_is_refused_with_a_sentence(run, given, says):
    assert says in refused(run("-", given=given))
