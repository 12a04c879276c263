"""Pictures from recordings."""
