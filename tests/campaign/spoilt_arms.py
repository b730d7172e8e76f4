"""Doctor over arms with one or two registers spoilt, against the truth of the arm that is moved.

Any joint's servo, of both types at their own supply. A register gets the ends of its range, or what
lies on either side of a limit of the judge (``servo_settings``); half of the arms have two of them.
A failure is an arm that is called ready to move and does not move well, or one that is refused and
moves well. Left out are the values that some joints bear and others do not: currents and torques
between what fails everywhere and what suffices everywhere, and a heat limit within 5 degC of now.
"""

import random

from harness.spoilt_arm import doctor_lets_it_move, spoilt, truth

from so101_motion.drivers.emulator import registers as emulated
from so101_motion.drivers.emulator.registers import Keep
from so101_motion.drivers.feetech.servo_settings import ADAPTED, PROTECTING
from so101_motion.drivers.servo_types import STS3215_7V4, STS3215_12V

KINDS = (STS3215_12V, STS3215_7V4)
OF_THE_CALIBRATION = ("OFFSET", "MIN_POSITION", "MAX_POSITION")  # other checks judge these
OTHERS = {
    "PHASE": (0, 4, 8, 13, 28, 44, 76, 140, 141, 157),
    "ID": (7, 9),
    "UNLOADING": (0, 4, 12, 36, 40, 63),
    "P_GAIN": (0, 1, 8, 15, 16, 64, 128, 254),
    "D_GAIN": (0, 100, 254),
    "I_GAIN": (10, 50, 51, 254),
    "MAX_ACCELERATION": (0, 1, 20, 50, 99, 100, 254),
    "MAX_TEMPERATURE": (20, 24, 30, 45, 59, 60, 80, 81, 100),
    "MAX_VOLTAGE": (60, 80, 140, 254),
    "MIN_VOLTAGE": (0, 40, 70, 100, 130),
    "MAX_TORQUE": (0, 450, 600, 1000),
    "PROTECTION_CURRENT": (0, 25, 50, 99, 100, 250, 2047),
    "OVERLOAD_TORQUE": (0, 19, 20, 27, 28, 100, 254),
}


def values():
    """What is tried, by register."""
    tried = dict(OTHERS)
    address = {row.address: name for name, row in emulated.REGISTERS.items()}
    for row in (*ADAPTED, *PROTECTING):
        name = address[row.register.address]
        edges = {row.lowest - 1, row.lowest, row.highest, row.highest + 1}
        tried.setdefault(name, tuple(sorted(v for v in edges if 0 <= v < 256)))
    for name, row in emulated.REGISTERS.items():
        if row.keep is Keep.EEPROM and name not in OF_THE_CALIBRATION:
            tried.setdefault(name, (row.lower, row.upper))
    return tried


def judge(changes, kind):
    """Whether doctor lets an arm move, and what goes wrong when it is moved."""
    return doctor_lets_it_move(spoilt(*changes, kind=kind)), truth(*changes, kind=kind)


def run(seed, *, count):
    """Judge ``count`` arms; those about which doctor is wrong."""
    rng, tried, wrong = random.Random(seed), values(), []
    for _ in range(count):
        names = rng.sample(sorted(tried), rng.randint(1, 2))
        changes = [(rng.randint(1, 6), name, rng.choice(tried[name])) for name in names]
        kind = rng.choice(KINDS)
        ready, trouble = judge(changes, kind)
        if ready == bool(trouble):
            wrong.append(f"{kind.name} {changes}: ready {ready}, {trouble or 'moves'}")
    return wrong
