"""Faults as components: in wires, behind drives, before parameters. Knows no other part and no experiment."""
