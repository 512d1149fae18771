"""The report of a result folder: plots and one self-contained page, made from the stored files alone."""

from experiments.report.write import write_report
from experiments.summary import recompute_metrics

__all__ = ["recompute_metrics", "write_report"]
