"""From measurements to the missing effect: compare, fit, diagnose, add, simulate."""
