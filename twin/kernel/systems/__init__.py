"""Systems of FMUs: files of several tools read, planned, coupled; from Python."""
