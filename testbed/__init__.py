"""What tests, experiments and benchmarks share: problems with known answers, judges, tables, figures."""
