"""A run that can be watched and tuned while it goes on, from Lichtblick or Foxglove (https://foxglove.dev)."""
