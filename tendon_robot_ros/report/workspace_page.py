"""The page that `workspace --output` writes."""

from __future__ import annotations

from ..analysis.workspace import Workspace
from .page import Page
from .workspace_figures import HEADER, degree, missing, rows, view_figures

FAMILIES = 4  # of a view that are drawn


def workspace_page(workspace: Workspace) -> Page:
    """Return the page: the table, then the largest families of every view."""
    page = Page(
        f'Range of motion: {workspace.robot.name}',
        f'{workspace.postures:,} postures; tensions from {workspace.pretension:g} to '
        f'{workspace.limit:g} N in steps of {workspace.step:g} N',
    )
    lacking = missing(workspace)
    if lacking:
        page.box(lacking, 'warn')
    if workspace.families:
        page.table(HEADER, rows(workspace), left=(1, 2))
    for view in workspace.views:
        families = workspace.of(view)
        if not families:
            continue
        page.heading(f'{degree(view)} view')
        if len(families) > FAMILIES:
            page.text(f'The {FAMILIES} of {len(families)} families with most postures.')
        for family in families[:FAMILIES]:
            page.figures(view_figures(family), 'two')
    return page
