"""What the benchmarks of running nodes share: processes, a source of samples, a bare relay and a
listener.
"""
