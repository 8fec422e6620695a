"""
The model: a description and tensions to a shape, and back.

model.py         `Model`, the one object that everybody uses
forward.py       what it stands on: tensions to shapes, batches and sequences of shapes
shape.py         what it returns: `Shape`, batches of shapes, markers placed on them, pictures,
                 `Reach`
tip_task.py      what is wanted of the tip, how a search weighs it and how long it may take
inverse.py       a pose, a target of the tip, to tensions within the limits
starts.py        the searches that this is made of, and where they start
redundancy.py    what the freedom of the tensions is used for; the arm kept out of regions
program.py       quadratic programs and least squares with bounds; the step of the tip by one
pulls.py         wire pulls to tensions, with slack wires
derivatives.py   slopes of an equilibrium with respect to tensions and parameters; how stiff the
                 tip is
mjcf.py          a robot as a file for MuJoCo
compile.py       a robot and its effects as the arrays of the kernel, which is composed from a
                 catalogue, compiled and cached
versions.py      the same package, effects and compiled kernel in every process of a study
kernel/          the compiled laws; nothing else of the model is compiled

Whoever changes what a cell does works in effects/ or in kernel/, not here.
"""
