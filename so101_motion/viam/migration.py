"""Migrate a machine's configuration from the published ``devrel:so101`` to this module.

The configuration is read, never changed: the same resources are written for this module, ready to
paste. Keys and other modules in it are never shown; of an unknown attribute only the name is. Both
generations of the gripper, with a port of its own or with the name of its arm, are understood.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from so101_motion.common.attributes import misspelt, suggest
from so101_motion.common.errors import ConfigError
from so101_motion.setup.discovery import own_module
from so101_motion.viam.models.configured import names_of_the_family
from so101_motion.viam.published_models import MODELS, OURS

FAMILY = "devrel:so101:"  # the beginning of the model names of both modules

_VERSION = re.compile(r"(\d+)\.(\d+)\.(\d+)(?:-rc\.?(\d+))?")
_LAST_MIDDLE = (0, 9, 0, 2)  # the last version whose zero is the middle of the travel: 0.9.0-rc2

PUBLISHED = "devrel:so101-arm"  # the published module's id in the registry


@dataclass(frozen=True, slots=True, kw_only=True)
class MigratedResource:
    """A component or service of the family; ``problem`` tells why it cannot be used as it is."""

    kind: str
    name: str
    model: str
    problem: str
    notes: tuple[str, ...]
    config: Mapping[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Migration:
    """The result of migrating a configuration."""

    parts: tuple[MigratedResource, ...]
    module: str  # the published module's name in it; empty without one
    notes: tuple[str, ...]

    def configuration(self) -> dict[str, list[object]]:
        whole: dict[str, list[object]] = {}
        for kind in ("components", "services"):
            found = [dict(part.config) for part in self.parts if part.kind == kind]
            if found:
                whole[kind] = list(found)
        name = self.module
        whole["modules"] = [{**entry, "name": name or entry["name"]} for entry in own_module()]
        return whole


def migrate(content: object) -> Migration:
    """Migrate a whole configuration, or a component or a list of components out of one."""
    whole = _whole(content)
    listed = whole.get("modules")
    modules = [m for m in listed if isinstance(m, Mapping)] if isinstance(listed, list) else []
    old = next((m for m in modules if m.get("module_id") == PUBLISHED), None)
    zero = None if old is None else _zero_of(old)
    parts = tuple(_part(kind, entry, zero) for kind, entry in _entries(whole))
    if not parts:
        hint = ", so there is nothing to migrate"
        if whole.get("fragments"):
            hint = "; its fragments may have some: take the configuration with fragments resolved"
        raise ConfigError("configuration", None, f"it has no model of {FAMILY}*{hint}")
    name = "" if old is None else str(old.get("name", ""))
    return Migration(parts=parts, module=name, notes=_notes(whole, parts))


def _whole(content: object) -> Mapping[str, Any]:
    if isinstance(content, list):
        return {"components": content}
    if not isinstance(content, Mapping):
        raise ConfigError("configuration", None, "must be a JSON object, as a machine's is")
    if "model" in content and "components" not in content:
        return {"components": [content]}
    return content


def _entries(whole: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    for kind in ("components", "services"):
        entries = whole.get(kind) or ()
        for entry in entries if isinstance(entries, list) else ():
            if isinstance(entry, Mapping) and _model(entry).startswith(FAMILY):
                yield kind, entry


def _model(entry: Mapping[str, Any]) -> str:
    """A model's triplet, also where an old configuration spells it as an object."""
    model = entry.get("model")
    if isinstance(model, Mapping):
        return ":".join(str(model.get(key, "")) for key in ("namespace", "model_family", "name"))
    return model if isinstance(model, str) else ""


def _zero_of(module: Mapping[str, Any]) -> str:
    """The ``joint_zero`` of the published module's version."""
    version = _VERSION.fullmatch(str(module.get("version", "")).removeprefix("v"))
    if version is None:  # such as "latest", or none given
        return "homing"
    *numbers, rc = version.groups()
    return "homing" if (*map(int, numbers), int(rc or 99)) > _LAST_MIDDLE else "middle"


def _notes(whole: Mapping[str, Any], parts: tuple[MigratedResource, ...]) -> tuple[str, ...]:
    notes = []
    if whole.get("fragments"):
        notes.append(
            "the machine uses fragments, and what they hold is not in this file; if one brings"
            f" {PUBLISHED}, change the module there"
        )
    if not own_module():
        notes.append(
            "viam-server cannot start this installation as a module; unpack the module's archive"
            ' on the machine and add it under "modules", with its run.sh as "executable_path"'
        )
    if any("calibration_file" in part.config["attributes"] for part in parts):
        notes.append(
            "keep the module's name: viam-server names the directory of the calibration files after"
            " it"
        )
    if added := sorted({key for part in parts for key in part.config["attributes"]} & OURS):
        notes.append(f"to go back, take out what only this module knows: {', '.join(added)}")
    return tuple(notes)


# One resource


def _part(kind: str, entry: Mapping[str, Any], zero: str | None) -> MigratedResource:
    model = _model(entry)
    given = entry.get("attributes") or {}
    if not isinstance(given, Mapping):
        given = {}
    known = MODELS.get(model.removeprefix(FAMILY))
    kept, problem, notes = dict[str, Any](), "", list[str]()
    if known is None:
        hint = suggest(model.removeprefix(FAMILY), MODELS)
        problem = f'"{model}" is not a model of this module; {hint}'
    else:
        names = [each.name for each in known.rows()]
        kept = {key: value for key, value in given.items() if key in names}
        for key in (each for each in given if each not in names):  # its value may be a secret
            meant = misspelt(key, names, names_of_the_family())
            hint = f'did you mean "{meant}"?' if meant else "ignored if it stays"
            notes.append(f'"{key}" is no attribute of this model: left out; {hint}')
        notes += [
            f'"{each.name}": {each.idle}'
            for each in known.rows()
            if each.idle and each.name in kept
        ]
        if zero and "joint_zero" in names and "joint_zero" not in given:
            kept["joint_zero"] = zero
            notes.append(
                f'"joint_zero": "{zero}" is added: so your version of the published module counts'
                " joint angles, and those that you have kept go on meaning the same"
            )
        try:
            notes += getattr(known.from_attributes(kept), "notes", ())
        except ConfigError as error:
            problem = str(error)
    word = "component" if kind == "components" else "service"
    api = f"{entry.get('namespace', 'rdk')}:{word}:{entry.get('type', '')}"
    return MigratedResource(
        kind=kind,
        name=str(entry.get("name", "")),
        model=model,
        problem=problem,
        notes=tuple(notes),
        config={
            "name": entry.get("name", ""),
            "api": entry.get("api") or api,
            "model": model,
            "attributes": kept,
            **{k: entry[k] for k in ("frame", "depends_on", "log_configuration") if k in entry},
        },
    )
