"""What the benchmarks share: data, bounds, peers and how results are told."""
