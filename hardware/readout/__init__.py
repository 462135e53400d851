"""From raw counts to resistances and forces."""
