"""`twin cosim`: a system of third-party FMUs run, recorded and described."""
