"""Where the measurements are that the tests use."""

import yaml
from source_tree import ROOT

TENTACLE = ROOT / 'data' / 'tentacle'
BLIND = ROOT / 'test' / 'data' / 'blind'
EXAMPLES = {'b': ROOT / 'data' / 'hinge_friction', 'f': ROOT / 'data' / 'tendon_stiffness'}
LETTERS = 'abcdefghijkl'


def blind(letter):
    """Return the folder of a blind case; it holds fit/ and check/."""
    return EXAMPLES.get(letter, BLIND / f'case_{letter}')


def truth(letter):
    """Return what a blind case hides: hidden, parameters, robot, design, noise, size, base."""
    return yaml.safe_load((BLIND / 'truth.yaml').read_text(encoding='utf-8'))[f'case_{letter}']
