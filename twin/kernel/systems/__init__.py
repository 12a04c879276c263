"""Systems of FMUs: read from files of several tools, planned, coupled and run; Python interface."""
