"""Live runs, watched and tuned in Lichtblick or Foxglove (https://foxglove.dev)."""
