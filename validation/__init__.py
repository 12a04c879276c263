"""The twin beside what others made: `make validation`, docs/validation.md."""
