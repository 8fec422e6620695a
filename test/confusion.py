"""What diagnoses said of robots with a known hidden cause, as a table."""

NAMING = ('missing_effect', 'ambiguous', 'wrong_parameter', 'several')


class Confusion:
    """Collects hidden cause, verdict and names; prints one line per case."""

    def __init__(self):
        self.rows = []

    def add(self, case, hidden, found):
        """Keep a case; return whether the diagnosis names what is hidden."""
        names = [effect.name for effect in found.effects]
        listed = {*names, *found.cannot_tell_apart}
        right = found.verdict in NAMING and set(hidden) <= listed
        self.rows.append((case, ' + '.join(hidden) or 'nothing', found.verdict, names,
                          max(len(found.cannot_tell_apart), len(names))))  # fmt: skip
        return right

    def table(self):
        """Return the table."""
        lines = [f'{"case":24s} {"hidden":32s} {"verdict":18s} {"class":>5s}  names']
        for case, hidden, verdict, names, size in self.rows:
            lines.append(f'{case:24s} {hidden:32s} {verdict:18s} {size:5d}  {", ".join(names)}')
        return '\n'.join(lines)
