"""The report of a judgement: one self-contained HTML file with verdict, sound, tables and figures."""
