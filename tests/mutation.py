"""What the tests of a room are worth: change its code, and see whether a test fails.

    python tests/mutation.py --out scores.json                    # a fixed sample, its unit tests
    python tests/mutation.py --again scores.json --out now.json   # the same changes once more
    python tests/mutation.py --again scores.json --wide --out all.json   # what lived, on more tests

All changes would take days, so a sample is drawn with a fixed seed. One change a run: a comparison,
an operator, a number, a condition, a call or ``raise`` left out; no words, defaults or constants of
modules. Tests are collected once a room; each change is made in memory, in a fork, where only tests
that enter the changed function run, quick ones first. Other processes do not have it.
"""

from __future__ import annotations

import argparse
import ast
import copy
import gc
import hashlib
import json
import os
import random
import resource
import sys
import threading
import time
from collections import Counter, defaultdict
from functools import partial
from pathlib import Path
from types import CodeType, FunctionType

import pytest
from hypothesis import Phase, settings

ROOT = Path(__file__).parents[1]
# room: its tests; those behind the dash for --wide
ROOMS = {
    "control": "unit/control unit/drivers/test_goal_limiter.py - unit/arm",
    "planning/timing": "unit/planning/timing - properties/test_trajectory_laws.py",
    "calib/record": "unit/calib/record - unit/calib/procedure unit/cli/test_cli_files.py",
    "drivers/bus": "unit/drivers/bus - unit/drivers/feetech bus/test_eeprom_writes.py",
    "viam/conversion": "unit/viam/conversion - unit/viam properties/test_orientation_vectors.py",
}
KEPT = "_hypothesis_internal_use_settings"
BRIEF = (Phase.explicit, Phase.generate)
LIVED = ("survived", "no test")
MOST_SECONDS = 60  # of the processor, for one change
SWAPS = {
    ast.Lt: ast.LtE, ast.LtE: ast.Lt, ast.Gt: ast.GtE, ast.GtE: ast.Gt, ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq, ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In,
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.And: ast.Or,
    ast.Or: ast.And,
}  # fmt: skip


def change(node: ast.AST) -> ast.AST | None:
    """The node with its one change; None if it has none."""
    new = copy.copy(node)
    match node:
        case ast.Compare() if type(node.ops[0]) in SWAPS:
            new.ops = [SWAPS[type(node.ops[0])](), *node.ops[1:]]
        case ast.BinOp() | ast.BoolOp() if type(node.op) in SWAPS:
            new.op = SWAPS[type(node.op)]()
        case ast.UnaryOp(op=ast.Not() | ast.USub()):
            return node.operand
        case ast.Constant(value=bool()):
            new.value = not node.value
        case ast.Constant(value=int() | float()):
            new.value = node.value + 1 if node.value in (0, 1) else node.value * 2
        case ast.If() | ast.IfExp() | ast.While():
            new.test = ast.UnaryOp(op=ast.Not(), operand=node.test)
        case ast.Expr(value=ast.Call()) | ast.Raise():
            return ast.Pass()
        case _:
            return None
    return new


def places(function: ast.AST) -> list[ast.AST]:
    """What can be changed in a function, in order."""
    found = [function] if change(function) is not None else []
    if isinstance(function, ast.Raise | ast.JoinedStr):
        return found  # words
    for name, value in ast.iter_fields(function):
        of_call = name == "args" and isinstance(function, ast.Call)
        if of_call or name not in ("decorator_list", "args", "returns", "annotation"):
            for each in value if isinstance(value, list) else [value]:
                found += places(each) if isinstance(each, ast.AST) else []
    return found


def functions_of(tree: ast.Module | ast.ClassDef, before: str = "") -> dict[str, ast.AST]:
    """Functions and methods by their qualified names; those inside functions belong to them."""
    found: dict[str, ast.AST] = {}
    for node in tree.body:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            found[before + node.name] = node  # of a property, its last
        elif isinstance(node, ast.ClassDef):
            found |= functions_of(node, f"{before}{node.name}.")
    return found


def mutants_of(room: str) -> dict[str, tuple[Path, str, int, str]]:
    """Of each change its file, function, number in it, and the mark of that function."""
    found = {}
    for path in sorted((ROOT / "so101_motion" / room).glob("*.py")):
        for name, function in functions_of(ast.parse(path.read_text())).items():
            mark = hashlib.sha256(ast.dump(function).encode()).hexdigest()[:12]
            for k, node in enumerate(places(function)):
                words = ast.unparse(node).splitlines()[0][:60]
                key = f"{path.stem}.{name} {k}: {type(node).__name__} {words}"
                found[key] = (path, name, k, mark)
    return found


def apply(path: Path, name: str, k: int) -> None:
    """Make the change in every function object that there is of it."""
    tree = ast.parse(path.read_text())
    wanted = places(functions_of(tree)[name])[k]

    class Change(ast.NodeTransformer):
        def visit(self, node: ast.AST) -> ast.AST | None:
            return change(node) if node is wanted else self.generic_visit(node)

    todo = [compile(ast.fix_missing_locations(Change().visit(tree)), str(path), "exec")]
    codes = {}
    while todo:
        code = todo.pop()
        codes[code.co_qualname] = code
        todo += [each for each in code.co_consts if isinstance(each, CodeType)]
    for each in gc.get_objects():
        if isinstance(each, FunctionType):
            old = each.__code__
            if old.co_filename == str(path) and old.co_qualname == name:
                each.__code__ = codes[name]


def _note(seen: set[CodeType], frame, event: str, _) -> None:
    if event == "call":
        seen.add(frame.f_code)


class Judge:
    """A plugin that runs the collected tests once a change."""

    def __init__(self, mutants: dict[str, tuple[Path, str, int, str]], out: Path) -> None:
        self.mutants, self.out = mutants, out

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        for each in session.items:
            function = getattr(each, "function", None)
            if (was := getattr(function, KEPT, None)) is not None:
                setattr(function, KEPT, settings(was, database=None, phases=BRIEF))
        entered, seconds = self._entered_by(session)
        result = {}
        for key, (path, name, k, mark) in self.mutants.items():
            tests = sorted(entered.get(f"{path} {name}", ()), key=seconds.get)
            ended = self._try(session, tests, (path, name, k)) if tests else "no test"
            result[key] = {"function": mark, "ended": ended}
            self.out.write_text(json.dumps(result, indent=1))
        return True

    def _entered_by(self, session: pytest.Session):
        """Which tests enter a function, and how long each takes; from a run in a child."""
        read, write = os.pipe()
        if (child := os.fork()) == 0:
            entered, seconds, failed = defaultdict(set), {}, []
            for i, item in enumerate(session.items):
                seen = set()
                look = partial(_note, seen)
                begin = time.process_time()
                threading.setprofile(look)
                sys.setprofile(look)
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
                sys.setprofile(None)
                seconds[i] = time.process_time() - begin
                if session.testsfailed > len(failed):  # it cannot be watched
                    failed.append(item.nodeid)
                    continue
                for code in seen.copy():  # other threads go on
                    entered[f"{code.co_filename} {code.co_qualname.split('.<')[0]}"].add(i)
            told = {key: sorted(tests) for key, tests in entered.items()}
            with os.fdopen(write, "w") as pipe:
                json.dump([told, seconds, failed], pipe)
            os._exit(0)
        os.close(write)
        with os.fdopen(read) as pipe:
            told, seconds, failed = json.load(pipe)
        os.waitpid(child, 0)
        print(*(f"\nfails without a change, so it is left out: {each}" for each in failed))
        return told, {int(i): each for i, each in seconds.items()}

    def _try(self, session: pytest.Session, tests: list[int], where) -> str:
        if (child := os.fork()) == 0:
            most = int(time.process_time()) + MOST_SECONDS
            resource.setrlimit(resource.RLIMIT_CPU, (most, most))
            apply(*where)
            for i in tests:
                item = session.items[i]
                item.config.hook.pytest_runtest_protocol(item=item, nextitem=None)
                if session.testsfailed:
                    os._exit(1)
            os._exit(0)
        end = time.monotonic() + 10 * MOST_SECONDS
        while not (done := os.waitpid(child, os.WNOHANG))[0]:
            if time.monotonic() > end:
                os.kill(child, 9)
            time.sleep(0.02)
        if os.WIFEXITED(done[1]):
            return "killed" if os.WEXITSTATUS(done[1]) else "survived"
        return "timeout"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--room", action="append", choices=ROOMS, help="this; may be repeated")
    parser.add_argument("--each", type=int, default=40, help="changes a room")
    parser.add_argument("--seed", type=int, default=50)
    parser.add_argument("--again", type=Path, help="the changes of an earlier run that still exist")
    parser.add_argument("--wide", action="store_true", help="those that lived, on more tests")
    parser.add_argument("--out", type=Path, default=Path("mutation.json"))
    asked = parser.parse_args()
    os.chdir(ROOT)
    sys.path.insert(0, str(ROOT))
    result = json.loads(asked.out.read_text()) if asked.out.exists() else {}
    before = json.loads(asked.again.read_text()) if asked.again else {}
    for room in asked.room or before or ROOMS:
        there = mutants_of(room)
        was = {k: v for k, v in before.get(room, {}).items() if k in there}
        keys = [k for k in was if there[k][3] == was[k]["function"]]
        if asked.wide:
            keys = [k for k in keys if was[k]["ended"] in LIVED]
        if not asked.again:
            keys = random.Random(asked.seed).sample(sorted(there), min(asked.each, len(there)))
        tests = ROOMS[room].split(" - ")[asked.wide].split()
        part = asked.out.with_suffix(f".{room.replace('/', '-')}.json").absolute()
        part.write_text("{}")  # of a room where nothing is left to be tried
        if (child := os.fork()) == 0:
            plugin = Judge({key: there[key] for key in keys}, part)
            how = [
                "-q", "-n", "0", "-p", "no:cacheprovider", "-p", "no:warnings", "-o", "timeout=0",
            ]  # fmt: skip
            pytest.main([*how, *(f"tests/{each}" for each in tests)], plugins=[plugin])
            os._exit(0)
        os.waitpid(child, 0)
        result[room] = json.loads(part.read_text())
        part.unlink()
        asked.out.write_text(json.dumps(result, indent=1))
        count = Counter(each["ended"] for each in result[room].values())
        print(f"{room}: {len(there)} possible, {len(keys)} tried, {dict(count)}")
        for key, each in result[room].items():
            if each["ended"] in LIVED:
                print(f"  {each['ended']}: {key}")


if __name__ == "__main__":
    main()
