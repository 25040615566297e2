"""The report of a judgement: one self-contained HTML file with verdict, sound, tables and figures."""

from foten.evaluate.report.page import write_report as write_report
