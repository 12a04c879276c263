"""Isolation: jobs that load foreign binaries run in a supervised process; what kills that process is named."""
