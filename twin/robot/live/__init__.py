"""Live runs, watched and tuned from Lichtblick or Foxglove (https://foxglove.dev)."""
