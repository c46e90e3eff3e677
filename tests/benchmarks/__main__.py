"""``python -m tests.benchmarks``: the identification benchmark by itself."""

from tests.benchmarks.bench_identify import main

main()
