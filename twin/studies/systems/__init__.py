"""`twin cosim`: run, record and describe a system of third-party FMUs."""
