import getpass
import os
import sys
from dataclasses import dataclass

import pytest
from serial.tools import list_ports

from so101_motion.drivers.port.port_list import (
    adapters_without_port,
    device_of,
    find_ports,
    open_error_text,
    port_problem,
)

KIT = {"vid": 0x1A86, "pid": 0x55D3, "product": "USB Single Serial"}
CHEAP = {"vid": 0x1A86, "pid": 0x7523, "product": "USB Serial"}
OTHER = {"vid": 0x2341, "pid": 0x0043, "product": "Arduino"}


@dataclass(eq=False)
class Listed:
    """What pyserial tells of a port."""

    device: str
    vid: int | None = None
    pid: int | None = None
    serial_number: str | None = None
    location: str | None = None
    product: str | None = None


class Machine:
    """A computer with ports, as pyserial and the file system show it."""

    def __init__(self, folder):
        self.folder, self.listed = folder, []
        self.links = folder / "serial"

    def plug(self, name, *, by_id=None, by_path=None, **told):
        """A port on Linux; the path of its device."""
        device = self.folder / name
        device.touch()
        for kind, link in (("by-id", by_id), ("by-path", by_path)):
            if link is not None:
                (self.links / kind).mkdir(parents=True, exist_ok=True)
                path = self.links / kind / link
                path.unlink(missing_ok=True)
                path.symlink_to(device)
        self.listed.append(Listed(str(device), **told))
        return str(device)

    def show(self, device, **told):
        """A port elsewhere, where names are all there is."""
        self.listed.append(Listed(device, **told))

    def ports(self, *extra):
        return find_ports(extra, links=self.links)


@pytest.fixture
def machine(tmp_path, monkeypatch):
    made = Machine(tmp_path)
    monkeypatch.setattr(list_ports, "comports", lambda: list(made.listed))
    return made


# Names


def test_a_port_is_named_by_its_serial_number_on_linux(machine):
    device = machine.plug(
        "ttyACM0", by_id="usb-1a86_USB_Single_Serial_58CD176705-if00", by_path="pci-0-usb-0:2:1.0",
        **KIT, serial_number="58CD176705", location="1-2",
    )  # fmt: skip
    (port,) = machine.ports()
    assert port.name.endswith("by-id/usb-1a86_USB_Single_Serial_58CD176705-if00")
    assert port.device == device
    assert port.key == "58CD176705"
    assert device in port.aliases
    assert len(port.aliases) == 2
    assert port.is_servo_adapter
    assert port.description == "USB Single Serial"


def test_names_stay_when_adapters_are_plugged_in_in_another_order(machine):
    told = {**KIT, "by_id": "usb-A"}, {**KIT, "by_id": "usb-B"}
    machine.plug("ttyACM0", **told[0], serial_number="A")
    machine.plug("ttyACM1", **told[1], serial_number="B")
    before = {port.key: port.name for port in machine.ports()}
    machine.listed.clear()
    machine.plug("ttyACM0", **told[1], serial_number="B")
    machine.plug("ttyACM1", **told[0], serial_number="A")
    assert {port.key: port.name for port in machine.ports()} == before


def test_adapters_without_serial_number_are_told_apart_by_their_sockets(machine):
    # Both have the same link by id; the system lets it lead to whichever came last.
    machine.plug("ttyUSB0", by_id="usb-1a86-if00", by_path="usb-0:2:1.0", **CHEAP, location="1-2")
    machine.plug("ttyUSB1", by_id="usb-1a86-if00", by_path="usb-0:3:1.0", **CHEAP, location="1-3.4")
    ports = machine.ports()
    assert [port.key for port in ports] == ["usb-1-2", "usb-1-3-4"]
    assert [port.name.rpartition("/")[2] for port in ports] == ["usb-0:2:1.0", "usb-0:3:1.0"]


def test_serial_numbers_that_several_adapters_share_are_none(machine):
    for i in range(2):
        told = {"serial_number": "0001", "location": f"1-{i}", "by_path": f"usb-{i}"}
        machine.plug(f"ttyUSB{i}", by_id="usb-0001", **CHEAP, **told)
    ports = machine.ports()
    assert [port.key for port in ports] == ["usb-1-0", "usb-1-1"]
    assert all("by-path" in port.name and port.serial_number is None for port in ports)


def test_a_device_that_macos_shows_several_times_is_one_port(machine):
    told = {**KIT, "serial_number": "58CD176705", "location": "1-1"}
    for name in ("tty.usbmodem58CD1767051", "cu.wchusbserial58CD1767051", "cu.usbmodem58CD1767051"):
        machine.show(f"/dev/{name}", **told)
    (port,) = machine.ports()
    assert port.name == "/dev/cu.usbmodem58CD1767051"
    assert port.key == "58CD176705"
    assert set(port.aliases) == {
        "/dev/tty.usbmodem58CD1767051", "/dev/cu.wchusbserial58CD1767051",
    }  # fmt: skip
    machine.show("/dev/cu.usbserial-1201", **CHEAP, location="1-2")
    assert [port.key for port in machine.ports()] == ["58CD176705", "usb-1-2"]


def test_windows_ports_keep_their_names(machine):
    machine.show("COM10", **KIT, serial_number="58CD")
    machine.show("COM3", **CHEAP)
    machine.show("COM1")
    assert [(port.name, port.key) for port in machine.ports()] == [
        ("COM3", "COM3"),
        ("COM10", "58CD"),
    ]


def test_keys_are_fit_for_names_of_resources_and_without_links_the_device_must_do(machine):
    device = machine.plug("ttyUSB0", **CHEAP)
    (port,) = machine.ports()
    assert (port.name, port.key) == (device, "ttyUSB0")
    machine.listed.clear()
    machine.plug("ttyACM0", **KIT, serial_number="a b/c:" + 60 * "9")
    (port,) = machine.ports()
    assert len(port.key) <= 40
    assert port.key.replace("-", "").replace("_", "").isalnum()


# Which, and in what order


def test_servo_adapters_come_first_and_what_is_no_usb_adapter_is_left_out(machine):
    machine.plug("ttyACM0", **OTHER)
    machine.plug("ttyACM10", **KIT, serial_number="A")
    machine.plug("ttyACM9", **KIT, serial_number="B")
    machine.plug("ttyS0")
    ports = machine.ports()
    assert [port.device.rpartition("/")[2] for port in ports] == ["ttyACM9", "ttyACM10", "ttyACM0"]
    assert [port.is_servo_adapter for port in ports] == [True, True, False]


def test_ports_of_the_user_come_first_under_his_names_and_once(machine):
    device = machine.plug("ttyACM0", by_id="usb-A", **KIT, serial_number="A")
    machine.plug("ttyACM1", by_id="usb-B", **KIT, serial_number="B")
    own = machine.folder / "leader"
    own.symlink_to(device)
    ports = machine.ports(str(own), "/dev/ttyAMA0", str(own))
    assert [port.key for port in ports] == ["A", "ttyAMA0", "B"]
    assert ports[0].name == str(own)
    assert device in ports[0].aliases


# Why a port cannot be used


def test_a_port_somebody_has_open_is_reported_without_opening_it(machine):
    device = machine.plug("ttyACM0", **KIT)
    assert port_problem(device) is None
    with open(device):
        reason = port_problem(device)
    assert f"process {os.getpid()}, this program" in reason
    assert reason.endswith("end that program first")


@pytest.mark.skipif(getpass.getuser() == "root", reason="root may everything")
def test_a_forbidden_port_is_reported(machine):
    device = machine.plug("ttyACM0", **KIT)
    os.chmod(device, 0)
    assert "not allowed" in port_problem(device)


def test_permission_names_the_group_that_owns_the_port(machine, monkeypatch):
    import grp

    error = PermissionError(13, "Permission denied")
    device = machine.plug("ttyACM0", **KIT)
    gid = os.stat(device).st_gid
    monkeypatch.setattr(
        grp, "getgrgid", lambda asked: {gid: grp.struct_group(("uucp", "", 1, []))}[asked]
    )
    assert "usermod -aG uucp" in open_error_text(device, error)
    monkeypatch.setattr(grp, "getgrgid", lambda asked: grp.struct_group(("root", "", 0, [])))
    assert "udev rule" in open_error_text(device, error)
    assert "usermod -aG dialout" in open_error_text("/dev/nowhere", error)


def test_windows_is_not_asked_for_what_it_cannot_tell(monkeypatch):
    monkeypatch.setattr(sys, "platform", "win32")
    assert port_problem("COM3") is None


@pytest.fixture
def system(tmp_path):
    """The kernel's view: USB devices, and what runs."""

    def make(ids=(0x1A86, 0x7523), tty=None, running=()):
        device = tmp_path / "usb" / "1-2"
        interface = device / "1-2:1.0"
        interface.mkdir(parents=True)
        for name, value in zip(("idVendor", "idProduct"), ids, strict=True):
            (device / name).write_text(f"{value:04x}\n")
        (tmp_path / "usb" / "usb1").mkdir()
        if tty:
            (interface / tty).mkdir(parents=True)
        for number, name in enumerate(("init", *running), start=1):
            (tmp_path / "proc" / str(number)).mkdir(parents=True)
            (tmp_path / "proc" / str(number) / "comm").write_text(f"{name}\n")
        return adapters_without_port(usb=tmp_path / "usb", processes=tmp_path / "proc")

    return make


@pytest.mark.parametrize(
    ("seen", "words"),
    [
        ({"running": ("brltty",)}, ("CH340", "1a86:7523", "sudo apt remove brltty")),
        ({"ids": (0x1A86, 0x55D3)}, ("modprobe",)),
    ],
)
def test_brltty_that_has_taken_the_adapter_or_a_missing_driver_is_named(system, seen, words):
    (said,) = system(**seen)
    assert all(word in said for word in words)


@pytest.mark.parametrize(
    "seen", [{"tty": "ttyUSB0"}, {"tty": "tty/ttyACM0"}, {"ids": (0x046D, 0xC31C)}]
)
def test_an_adapter_with_a_port_or_another_device_is_no_trouble(system, seen):
    assert system(**seen, running=("brltty",)) == ()


def test_all_names_of_a_port_are_one_device(tmp_path):
    (tmp_path / "ttyACM0").touch()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyACM0")
    assert device_of(str(tmp_path / "by-id")) == device_of(str(tmp_path / "ttyACM0"))
    assert device_of("/dev/cu.usbmodem5A1") == device_of("/dev/tty.usbmodem5A1")
    assert device_of("/dev/cu.usbmodem5A1") != device_of("/dev/cu.usbmodem5A2")
