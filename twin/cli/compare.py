"""`twin compare`: recordings against the paper."""


def compare() -> None:
    """to come"""
