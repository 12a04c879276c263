"""Process isolation: jobs that load foreign binaries run in a supervised process; a crash is reported by its cause."""
