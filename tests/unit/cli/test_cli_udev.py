import re

import pytest

from so101_motion.cli.ports import write_rule
from so101_motion.common.errors import PortUnavailable
from so101_motion.drivers.port import port_list
from so101_motion.drivers.port.port_list import ADAPTERS


def test_the_rule_goes_to_stdout_with_a_line_for_each_adapter_and_the_reasons_beside_it(so101):
    result = so101("install-udev")
    assert result.exit_code == 0
    assert result.stdout == port_list.udev_rules()
    for words in ("dialout", "usermod", "brltty", "install-udev --install"):
        assert words in result.stderr
    lines = [line for line in port_list.udev_rules().splitlines() if not line.startswith("#")]
    assert len(lines) == len(ADAPTERS)
    for line in lines:
        for part in line.split(", "):
            assert re.fullmatch(r'[A-Z]+(\{\w+\})?(==|=|\+=)"[^"]*"', part), part


def test_a_rule_is_installed_where_it_is_told_and_without_root_the_command_for_it_is_reported(
    tmp_path, capsys
):
    path = tmp_path / "70-so101.rules"
    assert not port_list.is_rule_installed(path)
    write_rule(path)
    assert port_list.is_rule_installed(path)
    assert str(path) in capsys.readouterr().out
    with pytest.raises(PortUnavailable, match=r"sudo .*install-udev --install"):
        write_rule(tmp_path / "no" / "such" / "folder" / "70-so101.rules")


def test_programs_that_meddle_are_seen(tmp_path):
    for number, name in enumerate(("bash", "ModemManager", "brltty")):
        (tmp_path / str(number)).mkdir()
        (tmp_path / str(number) / "comm").write_text(f"{name}\n")
    assert set(port_list.interfering_programs(tmp_path)) == {"ModemManager", "brltty"}
    assert port_list.interfering_programs(tmp_path / "nothing") == {}


def test_the_latency_of_an_ftdi_adapter_is_read(tmp_path):
    folder = tmp_path / "ttyUSB0" / "device"
    folder.mkdir(parents=True)
    (folder / "latency_timer").write_text("16\n")
    assert port_list.latency_timer("/dev/ttyUSB0", tmp_path) == 0.016
    assert port_list.latency_timer("/dev/ttyACM0", tmp_path) is None
