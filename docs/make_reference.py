"""A hook of the site that refuses a reference with gaps.

``docs/reference.md`` lists the names; mkdocstrings prints their docstrings. The build fails if a
name of the package is not listed, or if one that is listed, or a public member of it, has no
docstring. A field counts as described where its class's docstring names it.
"""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator
from functools import cached_property
from pydoc import locate
from typing import Any

import so101_motion
from so101_motion.control.motion_source import MotionSource

METHODS = (property, cached_property, classmethod, staticmethod)


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> None:
    """Refuse gaps before the page is made."""
    from properdocs.exceptions import PluginError  # the tests have no site

    if page.file.src_uri == "docs/reference.md" and (gaps := sorted(gaps_in(markdown))):
        raise PluginError("docs/reference.md:\n" + "\n".join(gaps))


def gaps_in(markdown: str) -> Iterator[str]:
    """What the page does not list, or what is not described, a sentence each."""
    paths = re.findall(r"^::: (\S+)", markdown, flags=re.MULTILINE)
    listed: list[Any] = [locate(path) for path in paths]
    for module in filter(inspect.ismodule, listed):
        listed += [each for each in vars(module).values() if is_ours(each, module.__name__)]
    for name in so101_motion.__all__:
        if name != "__version__" and getattr(so101_motion, name) not in listed:
            yield f"{name} is not listed"
    for path, each in zip(paths, listed, strict=False):
        if each is None:
            yield f"{path} does not exist"
    for each in filter(None, listed):
        yield from undescribed(each)


def is_ours(what: Any, module: str) -> bool:
    """Whether it is a public class of a module, or of one below."""
    return (
        inspect.isclass(what)
        and what.__module__.startswith(module)
        and not what.__name__.startswith("_")
    )


def undescribed(what: Any) -> Iterator[str]:
    """What has no docstring, of a name and its public members."""
    words = [what.__doc__ or ""]
    if not words[0] or words[0].startswith(f"{what.__name__}("):  # a dataclass makes one itself
        yield f"{what.__name__} has no docstring"
    if not inspect.isclass(what):
        return
    family = [each for each in what.__mro__ if is_ours(each, "so101_motion")]
    family.append(MotionSource)  # what the control loop asks of a motion; described only there
    words += [each.__doc__ or "" for each in family]
    for name in {
        name for each in family[:-1] for name in {**vars(each), **inspect.get_annotations(each)}
    }:
        found = [vars(each)[name] for each in family if name in vars(each)]
        docs = [it.__doc__ for it in found if isinstance(it, METHODS) or inspect.isroutine(it)]
        named = rf"``{name}``|^ *{name}: "
        if not (
            name.startswith("_") or any(docs) or re.search(named, "\n".join(words), re.MULTILINE)
        ):
            yield f"{what.__name__}.{name} has no docstring"
