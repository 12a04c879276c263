"""The worst case by search: which fault, when, how large and on what body takes an experiment furthest beyond what is
required of it."""
