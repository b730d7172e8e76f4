"""A hook of the site that refuses a reference with gaps.

``docs/reference.md`` lists the names; mkdocstrings prints their docstrings. The build fails if a
name of the package is not listed, or if one that is listed, or a public member of it, has no
docstring. A field counts as described where its class's docstring names it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import griffe
from properdocs.exceptions import PluginError

ROOT = Path(__file__).parents[1]
PACKAGE = "so101_motion"
PLAYED = "control.motion_source.MotionSource"
"""What the control loop asks of a motion; described only there, and hidden on the page."""


def on_page_markdown(markdown: str, *, page, config, files) -> None:  # type: ignore[no-untyped-def]
    """Refuse gaps before the page is made."""
    if page.file.src_uri != "docs/reference.md":
        return
    gaps = sorted(gaps_in(re.findall(r"^::: (\S+)", markdown, flags=re.MULTILINE)))
    if gaps:
        raise PluginError("docs/reference.md:\n" + "\n".join(gaps))


def gaps_in(listed: list[str]) -> Iterator[str]:
    """What is not listed or not described, a sentence each."""
    package = griffe.load(PACKAGE, search_paths=[ROOT], resolve_aliases=True)
    for name, member in package.members.items():
        if member.is_alias and member.target_path.startswith(PACKAGE):
            path = member.final_target.path
            if path not in listed and path.rpartition(".")[0] not in listed:
                yield f"{path}, the package's {name}, is not listed"
    for path in listed:
        yield from undescribed(package[path.removeprefix(f"{PACKAGE}.")], package[PLAYED])


def undescribed(what: griffe.Object, played: griffe.Object) -> Iterator[str]:
    """What has no docstring, of a name and its public members."""
    if not what.docstring:
        yield f"{what.path} has no docstring"
    family = [what, *what.mro(), played] if what.is_class else []
    words = "\n".join(each.docstring.value for each in family if each.docstring)
    for name, member in what.all_members.items() if what.is_class or what.is_module else ():
        if name.startswith("_") or (member.is_alias and not member.inherited):
            continue
        if what.is_module:
            yield from undescribed(member, played) if member.is_class else ()
        elif not re.search(rf"``{name}``|^ *{name}: ", words, flags=re.MULTILINE) and not any(
            name in each.members and each.members[name].docstring for each in family
        ):
            yield f"{what.path}.{name} has no docstring"
