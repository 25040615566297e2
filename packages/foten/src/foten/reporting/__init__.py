"""One writer of tables and one of figures, for experiments, the evaluation's report, documents and benchmarks."""
