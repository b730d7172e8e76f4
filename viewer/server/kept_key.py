"""Keep a page's key for the next start, so that a browser that was left open finds its page again.

The keys are in the user's data folder, in a file that nobody else can read.
"""

from __future__ import annotations

import logging
import os
import secrets
import sys
import time
from collections.abc import Callable, Mapping
from pathlib import Path

from so101_motion.common.errors import ConfigError
from so101_motion.files import user_storage

SCHEMA = "so101/page-keys/1"

LIFETIME = 30 * 86_400.0  # how long a key is used [s]; chosen: a month

_MOST = 50  # keys that are kept; chosen: nobody has more arms
_LEAST_LENGTH = 40  # characters; shorter ones are not our keys

log = logging.getLogger(__name__)

KeyOf = Callable[[int], str]  # makes the key of a page that is served on a port


def new_key(_port: int = 0) -> str:
    return secrets.token_urlsafe(32)


def key_for(page: str, port: int, *, is_new: bool = False) -> str:
    """The key of a page such as ``"Arm on /dev/ttyACM0"``: the one of its last start, or a new one.

    The same page on another port has a key of its own; ``is_new`` ends an earlier one.
    """
    try:
        file = user_storage.folder() / "page-keys.json"
        with user_storage.locked(file):
            return _kept(file, f"{page}, port {port}", is_new=is_new)
    except ConfigError as error:
        log.info("the page's key is not kept: %s", error)
        return new_key()


def _kept(file: Path, name: str, *, is_new: bool) -> str:
    kept = _read(file)
    if name in kept and not is_new:
        return str(kept[name]["key"])
    kept[name] = {"key": new_key(), "made_at": int(time.time())}
    newest = sorted(kept, key=lambda each: -float(str(kept[each]["made_at"])))[:_MOST]
    if not file.exists():
        os.close(os.open(file, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o600))
    user_storage.write(file, {"keys": {each: kept[each] for each in newest}}, schema=SCHEMA)
    return str(kept[name]["key"])


def _read(file: Path) -> dict[str, Mapping[str, object]]:
    """The keys that are still good; none from a file that others can read."""
    if not file.exists():
        return {}
    if sys.platform != "win32":
        found = file.stat()
        if found.st_mode & 0o077 or found.st_uid != os.getuid():
            file.unlink()
            return {}
    try:
        keys = user_storage.read(file, schema=SCHEMA).get("keys")
    except ConfigError:
        file.unlink()
        return {}
    return {
        name: each
        for name, each in (keys.items() if isinstance(keys, Mapping) else ())
        if isinstance(each, Mapping) and _is_good(each.get("key"), each.get("made_at"))
    }


def _is_good(key: object, made_at: object) -> bool:
    if not isinstance(key, str) or len(key) < _LEAST_LENGTH or not key.isascii():
        return False
    return isinstance(made_at, int) and 0.0 <= time.time() - made_at <= LIFETIME
