"""What the twin can do with the FMUs of others."""
