"""Identify the servos on a bus, and whether they are a leader arm or a follower arm.

``look`` and ``read_facts`` read registers and write nothing. Everything else here needs no bus.

All six servos of both arms report the same model, because gears do not show in any register. These
tell a leader from a follower, in this order:

* a calibration file that LeRobot keeps for one of the two and that agrees with the servos;
* 12 V servos: leaders are built from 7.4 V servos only;
* settings that LeRobot has stored: it weakens the position loop and limits the jaw of a follower,
  and does neither to a leader.

Otherwise the answer is ``unknown``, without guessing: a leader must not be taken for a follower.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Literal

from so101_motion.calib.record import compare
from so101_motion.calib.record.file_search import FoundFile
from so101_motion.calib.record.record import JOINTS, SERVO_IDS, HeldCalibration
from so101_motion.common.errors import BusError, CorruptReply, PortUnavailable
from so101_motion.common.state import ARM_JOINTS
from so101_motion.drivers.bus import registers as reg
from so101_motion.drivers.bus.bus import Bus
from so101_motion.drivers.bus.registers import Fault, Register
from so101_motion.drivers.feetech.servo_judgement import (
    ServoTrouble,
    judge,
    judge_supply,
    nominal_volts,
)
from so101_motion.drivers.feetech.servo_settings import OddSetting, odd_settings, read_registers

Role = Literal["follower", "leader", "unknown"]

_ASKED, _GARBLED = 60, 0.15
"""How often all servos are asked for colliding answers, which takes 0.1 s, and the share of garbled
answers that tells of them. Chosen: a bus with half as many is unusable (``BROKEN``)."""

_MODELS = {reg.STS3215_MODEL: "sts3215", 2825: "sts3250", 1540: "sts3250"}  # LR; Feetech's Go users


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoFacts:
    """The registers of one servo, and what follows from them."""

    servo_id: int
    held: Mapping[str, int]  # the registers by name, decoded
    # whether its calibration says that it counts down with the joint angle
    counts_down: bool = False

    def holds(self, register: Register) -> int:
        return self.held[register.name]

    @property
    def model(self) -> str:
        """The published module's name of its model; a number if it has no name."""
        number = self.holds(reg.MODEL_NUMBER)
        return _MODELS.get(number, f"model {number}")

    @property
    def fits_arm(self) -> bool:
        """Whether it can drive a joint: an STS3215, or the stronger STS3250 with its registers."""
        return self.holds(reg.MODEL_NUMBER) in _MODELS

    @property
    def model_note(self) -> str:
        """What it means that it is no STS3215, though it can drive a joint; empty if it is one."""
        if self.model == "sts3215" or not self.fits_arm:
            return ""
        return f"is an {self.model}: it works, with the speed and strength planned for an STS3215"

    @property
    def firmware(self) -> str:
        return f"{self.holds(reg.FIRMWARE_MAJOR)}.{self.holds(reg.FIRMWARE_MINOR)}"

    @property
    def volts(self) -> float:
        """Its supply voltage [V]."""
        return self.holds(reg.PRESENT_VOLTAGE) / 10.0

    @property
    def highest_volts(self) -> float:
        """The upper limit of its supply voltage [V]."""
        return self.holds(reg.MAX_VOLTAGE) / 10.0

    @property
    def lowest_volts(self) -> float:
        """The lower limit of its supply voltage [V]."""
        return self.holds(reg.MIN_VOLTAGE) / 10.0

    @property
    def nominal_volts(self) -> float:
        """The supply it is sold for [V]: 7.4 or 12, by its own limit."""
        return nominal_volts(self.highest_volts)

    @property
    def troubles(self) -> tuple[ServoTrouble, ...]:
        return judge(
            volts=self.volts,
            lowest_volts=self.lowest_volts,
            highest_volts=self.highest_volts,
            celsius=self.holds(reg.PRESENT_TEMPERATURE),
            load=self.holds(reg.PRESENT_LOAD) * reg.PRESENT_LOAD.scale,
            amps=self.holds(reg.PRESENT_CURRENT) * reg.PRESENT_CURRENT.scale,
            faults=Fault(self.holds(reg.STATUS)).names,
        )

    @property
    def supply_trouble(self) -> tuple[str, str] | None:
        """What is wrong with its supply and what to do about it; None if it will do."""
        found = judge_supply(self.volts, self.lowest_volts, self.highest_volts)
        return None if found is None or found.level == "note" else (found.sentence, found.fix)

    @property
    def has_harmful_supply(self) -> bool:
        return any(each.kind == "supply" and each.level == "stop" for each in self.troubles)

    @property
    def odd_settings(self) -> tuple[OddSetting, ...]:
        """The settings with which it does not move its joint well; see ``servo_settings``."""
        return odd_settings(self.held, counts_down=self.counts_down)

    @property
    def has_sound_limits(self) -> bool:
        """Whether its limits leave it a travel; equal ones let it turn without end."""
        return self.holds(reg.MIN_POSITION) < self.holds(reg.MAX_POSITION)

    @property
    def calibration(self) -> HeldCalibration:
        """The calibration that it holds."""
        return HeldCalibration(
            homing_offset=self.holds(reg.HOMING_OFFSET),
            range_min=self.holds(reg.MIN_POSITION),
            range_max=self.holds(reg.MAX_POSITION),
        )

    @property
    def is_calibrated(self) -> bool:
        """Whether it has ever been given limits or an offset."""
        return self.calibration != HeldCalibration()


@dataclass(frozen=True, slots=True, kw_only=True)
class ServosOnBus:
    """The servos that were found on a bus."""

    baud: int  # the bus's rate [bit/s]
    servos: Mapping[int, ServoFacts]  # the registers of each, by its id
    shared: tuple[int, ...] = ()  # ids whose replies are corrupt, because several servos have them
    garbled: bool = False  # whether the replies to a ping of all servos were corrupt

    @property
    def is_empty(self) -> bool:
        return not (self.servos or self.shared or self.garbled)

    @property
    def has_arm(self) -> bool:
        """Whether all five servos of an arm are there and of its kind."""
        return all(self.has(SERVO_IDS[joint]) for joint in ARM_JOINTS)

    @property
    def held(self) -> dict[str, HeldCalibration]:
        """The calibration that each servo holds, by joint."""
        found = ((joint, self.servos.get(i)) for joint, i in SERVO_IDS.items())
        return {joint: facts.calibration for joint, facts in found if facts is not None}

    @property
    def travels(self) -> dict[str, int]:
        """The travel that its limits leave each calibrated servo [tick], by joint."""
        return {
            joint: held.range_max - held.range_min
            for joint, held in self.held.items()
            if held != HeldCalibration()
        }

    @property
    def unexpected_ids(self) -> tuple[int, ...]:
        return tuple(i for i in (*self.servos, *self.shared) if i not in SERVO_IDS.values())

    def has(self, servo_id: int) -> bool:
        """Whether this servo is there and can drive a joint."""
        facts = self.servos.get(servo_id)
        return facts is not None and facts.fits_arm


def read_facts(bus: Bus, servo_id: int) -> ServoFacts:
    return ServoFacts(servo_id=servo_id, held=read_registers(bus, servo_id))


def look(
    bus: Bus, ids: Collection[int] = tuple(SERVO_IDS.values()), turned: Collection[int] = ()
) -> ServosOnBus:
    """Find the servos at the bus's baud rate; writes nothing. Those ``turned`` count down.

    A ping to all finds every servo. A reply to it may get lost, so the ids of an arm are pinged one
    by one as well. Servos that share an id are found by what they answer together.
    """
    roll = bus.ping_all()
    servos: dict[int, ServoFacts] = {}
    shared = []
    for servo_id in sorted({*roll.ids, *bus.answering(ids)}):
        try:
            servos[servo_id] = replace(read_facts(bus, servo_id), counts_down=servo_id in turned)
        except PortUnavailable:
            raise
        except CorruptReply:
            shared.append(servo_id)
        except BusError:
            continue  # it answered a moment ago and is gone
    for servo_id in colliding(bus, servos):
        del servos[servo_id]
        shared.append(servo_id)
    return ServosOnBus(
        baud=bus.port.baud, servos=servos, shared=tuple(sorted(shared)), garbled=roll.garbled
    )


def colliding(bus: Bus, ids: Collection[int]) -> tuple[int, ...]:
    """Ids whose answers are garbled again and again, because several servos have them.

    Servos that hold the same values send the same bytes, which garble each other only now and then.
    If most ids are garbled it is the cable.
    """
    row, before = reg.MODEL_NUMBER, {i: bus.counters[i].corrupt for i in ids}
    for _ in range(_ASKED if ids else 0):
        bus.sync_read(ids, row.address, row.size)
    found = tuple(i for i in ids if bus.counters[i].corrupt - before[i] > _GARBLED * _ASKED)
    return found if len(ids) < 3 or 2 * len(found) <= len(ids) else ()


# Judgement


def fits(seen: ServosOnBus, found: FoundFile) -> bool:
    calibration = found.stored.calibration if found.stored is not None else {}
    is_whole = all(joint in calibration for joint in ARM_JOINTS)
    return is_whole and compare.agrees(calibration, seen.held)


def role(seen: ServosOnBus, files: Iterable[FoundFile] = ()) -> tuple[Role, str]:
    """Whether the arm is a leader or a follower, and why."""
    if not seen.has_arm:
        return "unknown", "it is not a complete arm"
    for found in files:
        if found.role in ("follower", "leader") and fits(seen, found):
            named: Role = "leader" if found.role == "leader" else "follower"
            return named, f"{found.path} is a {named}'s calibration and agrees with its servos"
    arm = [seen.servos[i] for i in SERVO_IDS.values() if i in seen.servos]
    if any(facts.nominal_volts == 12.0 for facts in arm):
        return "follower", "it has 12 V servos, and leaders are built with 7.4 V servos only"
    if _has_guarded_jaw(seen) or all(facts.holds(reg.P_GAIN) == 16 for facts in arm):
        return "follower", "LeRobot has set its servos up as a follower's"
    return (
        "unknown",
        "leaders and followers both have 7.4 V servos, and nothing tells them apart",
    )


def _has_guarded_jaw(seen: ServosOnBus) -> bool:
    """Whether LeRobot has limited the jaw's current and torque, which it does on followers."""
    jaw = seen.servos.get(SERVO_IDS[JOINTS[-1]])
    if jaw is None:
        return False
    return (jaw.holds(reg.PROTECTION_CURRENT), jaw.holds(reg.OVERLOAD_TORQUE)) == (250, 25)
