"""Long functions written in sections: the sections' statements take the place of their calls."""

from __future__ import annotations

import ast

import pytest

from twin.codegen.sections import joined


def run(text: str, *arguments: float) -> float:
    """What `whole` gives once its sections are in place."""
    names: dict = {}
    exec(compile(ast.fix_missing_locations(joined(ast.parse(text))), "<whole>", "exec"), names)
    assert set(names) - {"__builtins__"} == {"whole"}
    return names["whole"](*arguments)


def test_a_section_reads_and_writes_the_variables_of_the_whole() -> None:
    text = '''
def doubled(s):
    """Twice as much."""
    added = s.value
    s.value = s.value + added

def whole(value, times):
    for _ in range(times):
        doubled(s)
    return value
'''
    assert run(text, 3.0, 4) == 48.0


def test_a_section_may_have_sections_and_loops_of_its_own() -> None:
    text = """
def inner(limit, s):
    for n in range(10):
        if n == limit:
            break
        s.total = s.total + n

def outer(limit, s):
    s.total = 100
    inner(limit, s)

def whole(limit):
    outer(limit, s)
    return total
"""
    assert run(text, 4) == 106


@pytest.mark.parametrize(
    ("section", "call", "said"),
    [
        ("def part(s):\n    own = 1\n    s.value = own", "part(s)\n    own = value", r"names of its own.*\['own'\]"),
        ("def part(s):\n    value = 1", "part(s)", r"names of its own.*\['value'\]"),
        ("def part(s):\n    s.value = 1\n    return 2", "part(s)", "returns"),
        ("def part(x, s):\n    s.value = x", "part(value, s)", r"takes \(x, s\), by these names"),
    ],
)
def test_what_would_change_its_meaning_is_refused(section: str, call: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        joined(ast.parse(f"{section}\n\ndef whole(value, x):\n    {call}\n    return value\n"))
