"""The bytes of one servo: RAM, and the flash that survives a power cut.

Every address is readable. Writing reaches EEPROM and RAM registers alike and takes effect at
once; while Lock is 0 the EEPROM bytes are also saved. Measured bytes inside a written span are
skipped silently, as in the servo. What a value does is in ``servo.py``.
"""

from __future__ import annotations

from collections.abc import Mapping

from so101_motion.drivers.emulator import registers as reg
from so101_motion.drivers.emulator.registers import Keep, Register


def _keep_by_address() -> list[Keep]:
    """Who may write each byte; the gaps are RAM up to Lock and measured above it."""
    keep = [Keep.RAM] * (reg.LOCK.address + 1)
    keep += [Keep.READ_ONLY] * (reg.SIZE - len(keep))
    for row in reg.REGISTERS.values():
        keep[row.address : row.address + row.size] = [row.keep] * row.size
    return keep


_KEEP = _keep_by_address()
_WRITABLE = tuple(keep is not Keep.READ_ONLY for keep in _KEEP)
_SAVED = tuple(keep is Keep.EEPROM for keep in _KEEP)


class Memory:
    """The 87 ``bytes`` of a servo; ``flash`` is what a power cut leaves.

    ``factory`` has values that differ from the table's defaults in this particular servo.
    """

    def __init__(self, factory: Mapping[Register, int] | None = None) -> None:
        self.bytes = bytearray(reg.SIZE)
        for row in reg.REGISTERS.values():
            self.set(row, row.default)
        for row, raw in (factory or {}).items():
            self.set(row, raw)
        self.flash = bytes(self.bytes)
        self._backup = self.flash

    def raw(self, row: Register) -> int:
        address = row.address
        if row.size == 1:
            return self.bytes[address]
        return self.bytes[address] | self.bytes[address + 1] << 8

    def value(self, row: Register) -> int:
        """The value the servo uses: sign decoded, clamped to the row's range."""
        value = self.raw(row)
        if row.sign_bit is not None:
            value = row.decode(value)
        return row.lower if value < row.lower else row.upper if value > row.upper else value

    def set(self, row: Register, raw: int) -> None:
        """Store bits, even in a read-only register."""
        address = row.address
        if row.size == 1:
            self.bytes[address] = raw
        else:
            self.bytes[address], self.bytes[address + 1] = raw & 0xFF, raw >> 8

    def read(self, address: int, count: int) -> bytes | None:
        """The bytes of a READ, cut at the last register; None where there are none."""
        if address >= reg.SIZE or count == 0:
            return None
        return bytes(self.bytes[address : address + count])

    def write(self, address: int, data: bytes) -> range:
        """Store the bytes of a WRITE; return the addresses that were reached."""
        reached = range(address, min(address + len(data), reg.SIZE))
        saved = None if self.bytes[reg.LOCK.address] else bytearray(self.flash)
        for here, byte in zip(reached, data, strict=False):
            if _WRITABLE[here]:
                self.bytes[here] = byte
                if saved is not None and _SAVED[here]:
                    saved[here] = byte
        if saved is not None:
            self.flash = bytes(saved)
        return reached

    def save(self, row: Register) -> None:
        """Save one register now, locked or not (what the position calibration does)."""
        saved = bytearray(self.flash)
        span = slice(row.address, row.address + row.size)
        saved[span] = self.bytes[span]
        self.flash = bytes(saved)

    def keep(self, row: Register, raw: int) -> None:
        self.set(row, raw)
        self.save(row)

    def boot(self) -> None:
        """Reset at power-up: EEPROM from flash, RAM from defaults, torque limit from maximum."""
        self.bytes[:] = self.flash
        for row in reg.REGISTERS.values():
            if row.keep is not Keep.EEPROM:
                self.set(row, row.default)
        self.set(reg.TORQUE_LIMIT, self.raw(reg.MAX_TORQUE))

    def save_backup(self) -> None:
        self._backup = bytes(self.bytes)

    def restore(self) -> None:
        """Bring back the backup (a new servo's values if none was made), except the id."""
        own_id = self.bytes[reg.ID.address]
        self.flash = self._backup
        self.boot()
        self.set(reg.ID, own_id)
        self.save(reg.ID)
