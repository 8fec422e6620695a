"""What the reproduction of the paper assumes, in words."""

from __future__ import annotations

SOURCE = (
    'T. Kato, I. Okumura, S.-E. Song, A. J. Golby, N. Hata: Tendon-Driven Continuum Robot for '
    'Endoscopic Surgery: Preclinical Development and Validation of a Tension Propagation Model, '
    'IEEE/ASME Transactions on Mechatronics 20 (2015), doi 10.1109/TMECH.2014.2372635. "Trials" '
    'on this page are simulated.'
)
ASSUMED = (
    ['slip angles (IV.A, Table II)', 'drawn: SD 0.03, read to 0.1°',
     'only mean and n are printed'],
    ['wires of a group (Table I)', 'three at one place, arm 0.65 mm, 5 N each',
     'gives the published 50 mm; others are shown'],
    ['"180°" on a grid of 0.1 N', 'within ±2.5°', 'an exact 180° is hardly ever on the grid'],
    ['inputs that are not pulled (IV.B)', '0.1 N', 'pretension, as published'],
    ['arm of the 10:1 prototype (Table III)', '5.5 mm',
     'FKM and PCCA then differ as IV.D requires'],
    ['cells of the 10:1 prototype', '208 mm / 30, arcs', 'the FKM of the paper chains arcs'],
    ['hinge friction', 'lever 0.40 mm, hidden in the simulated prototype',
     'one number for all four errors of IV.D; the suspect of section V'],
    ['wires and pulls of IV.C (Table IV)', 'opposite sides, no other wires; from the FKM',
     'FKM and PCCA then differ as the published errors require'],
    ['three tip heights', 'highest, median, lowest with taut wires and no S-shape',
     'the tensions are not printed'],
    ['scatter of the cells', '2° of every prototype, 1° from trial to trial',
     '2° is published; what varies between trials is not'],
    ['hand and camera', '0.1 mm of wire pull, 0.09 mm of position', 'caliper; a pixel'],
    ['IV.D', 'tensions known to 5 %, 2 % and 1 mm from trial to trial, friction to 10 %, '
     'stiffness to 5 %', 'weights behind pulleys; nothing is printed'],
    ['2:1 prototype', 'one section of 60 mm, 30 cells, arm 1.3 mm', 'twice the target scale'],
)  # fmt: skip
