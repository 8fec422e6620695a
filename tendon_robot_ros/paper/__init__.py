"""
The experiments of Kato et al. 2015 (doi 10.1109/TMECH.2014.2372635), section IV.

experiments.py    all of them, and the published numbers beside ours; the 2:1 prototype (IV.E)
slip.py           friction coefficients from slip angles (IV.A)
motion.py         range of motion of tendon arrangements (IV.B)
displacement.py   posture by wire pull (IV.C)
tension.py        posture by tension (IV.D)
robots.py         variants of the paper's robots
"""
