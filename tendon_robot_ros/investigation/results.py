"""What an investigation leaves behind: data, recording, description, report."""

from __future__ import annotations

import argparse
import importlib.util
from pathlib import Path

from ..common.files import new_file
from ..data import save_dataset
from ..data.recording.writer import export_bag
from ..effects import Catalogue
from ..report.addition_text import never_used, warnings
from ..report.diagnosis_page import pictures_of, with_effects, write_diagnosis
from ..report.diagnosis_text import lines
from ..robot import dump_robot
from .loop import Findings
from .record import BETTER, CHECK, DATA

RECORDING, RESULT, REPORT = 'recording.mcap', 'diagnosis.json', 'report.html'


def add_folder(parser: argparse.ArgumentParser) -> None:
    """Declare where it is written, and what is kept out."""
    add = parser.add_argument
    add('--output', required=True, metavar='DIR', help='new folder')
    add('--resume', action='store_true', help='go on with what DIR has')
    add('--keep-out', metavar='YAML', help='regions where no part of the arm may be')


def write_results(findings: Findings, folder: Path, catalogue: Catalogue, add: bool) -> list[str]:
    """
    Write everything beside the data; return the lines to print.

    Recording and report need their extras (rosbags, plotly) and are left out without.

    Parameters
    ----------
    findings : Findings
    folder : Path
    catalogue : Catalogue
    add : bool
        Write the description even where the verdict is a class, or the intervals are wide.

    """
    found, made = findings.diagnosis, findings.made
    written = [DATA] if len(findings.dataset.postures) else []
    if findings.check is not None:
        save_dataset(findings.check, folder / CHECK, True)
        written.append(CHECK)
    if written and importlib.util.find_spec('rosbags') is not None:
        (folder / RECORDING).unlink(missing_ok=True)
        export_bag(findings.dataset, folder / RECORDING)
        written.append(RECORDING)
    text = [] if found is None else ['', *lines(found)]
    if found is not None:
        found.save(folder / RESULT)
        written.append(RESULT)
        if importlib.util.find_spec('plotly') is not None:
            better = with_effects(found, findings.dataset.robot) if made is None else made.robot
            pictures = pictures_of(found, findings.dataset, catalogue, better)
            write_diagnosis(found, pictures, folder / REPORT, made)
            written.append(REPORT)
    if made is not None:
        text += [never_used(made), *warnings(made)]
        if made.helps and (findings.may_add or add):
            with new_file(folder / BETTER) as draft:
                draft.write_text(dump_robot(made.robot), encoding='utf-8')
            written.append(BETTER)
            text.append(f'controller parameter model := {folder / BETTER}')
    return [*text, f'written: {folder}: {", ".join(written)}']
