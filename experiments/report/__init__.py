"""The report of a result folder: plots and one self-contained page, made from the stored files alone.

Pages are templates (templates/*.html) with their style and scripts written into them: plain JavaScript in one scope, in
the order of ``page.SCRIPTS``. What a script shows it reads from JSON in the page, which ``data`` makes.
"""

from experiments.report.write import write_report
from experiments.results.summary import recompute_metrics

__all__ = ["recompute_metrics", "write_report"]
