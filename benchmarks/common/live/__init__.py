"""Shared by the benchmarks of nodes: processes, a source of samples, a relay, a listener."""
