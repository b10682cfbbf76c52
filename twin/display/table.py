"""Tables for a terminal and for a notebook, and a base class for objects that print as one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape


@dataclass(frozen=True)
class DisplayTable:
    """Rows of text below a title; `notes` are sentences that stand below the rows."""

    title: str
    columns: tuple[str, ...]
    rows: Sequence[Sequence[str]]
    notes: Sequence[str] = ()

    def __str__(self) -> str:
        shown = [self.columns, *self.rows] if any(self.columns) else [*self.rows]
        widths = [max(len(row[i]) for row in shown) for i in range(len(self.columns))] if shown else []
        lines = ["  ".join(cell.ljust(w) for cell, w in zip(row, widths, strict=True)).rstrip() for row in shown]
        return "\n".join([self.title, *(f"  {line}" for line in lines), *self.notes])

    def to_html(self) -> str:
        """The same table as HTML."""
        head = "".join(f"<th>{escape(name)}</th>" for name in self.columns) if any(self.columns) else ""
        body = ["".join(f"<td>{escape(cell)}</td>" for cell in row) for row in self.rows]
        rows = "".join(f"<tr>{row}</tr>" for row in [head, *body] if row)
        notes = "".join(f"<p>{escape(note)}</p>" for note in self.notes)
        return f"<p><b>{escape(self.title)}</b></p><table>{rows}</table>{notes}"


class Tabular:
    """An object that prints as its table: as text in a terminal, as HTML in a notebook."""

    def table(self) -> DisplayTable:
        """What is shown of the object."""
        raise NotImplementedError

    def __str__(self) -> str:
        return str(self.table())

    def __repr__(self) -> str:
        return str(self.table())

    def _repr_html_(self) -> str:
        return self.table().to_html()
