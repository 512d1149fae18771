"""What leaving out saved, as a part of a report."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from experiments.savings import EVERYTHING
from experiments.tables import Row

HEAD = ("scene", "label", "left out", "because", "how often", "without [ms]", "with [ms]", "times", "images differ by")


def savings_section(rows: Sequence[Row]) -> str:
    """An HTML table of the rows of savings.csv, a label's total in bold; empty without rows.

    Args:
        rows: As ``experiments.tables.read_table`` gives them.
    """
    if not rows:
        return ""
    body = []
    for row in rows:
        difference = float(row["image_difference"])
        numbers = [
            f"{float(row['ms_without']):.2f}",
            f"{float(row['ms_with']):.2f}",
            f"{float(row['ratio']):.2f}",
            "0" if difference == 0.0 else f"{difference:.2g}",
        ]
        texts = [row["scene"], row["label"], row["what"], row["reason"]]
        cells = [f"<td>{escape(text)}</td>" for text in texts]
        cells += [f'<td class="number">{escape(str(text))}</td>' for text in (row["count"], *numbers)]
        mark = ' style="font-weight: bold"' if row["what"] == EVERYTHING else ""
        body.append(f"<tr{mark}>{''.join(cells)}</tr>")
    head = "".join(f"<th>{escape(text)}</th>" for text in HEAD)
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n" + "\n".join(body) + "\n</tbody></table>"
