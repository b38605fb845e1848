"""Random edits of valid problem files: each must be read, or refused in one-line errors; never a traceback.

An edit deletes, doubles or swaps lines, replaces a value or a key by something odd, or changes
single characters. A file that is still valid is built, mesh and all, but not solved.
hypothesis shrinks a failure to the simplest edit that makes it.
"""

from __future__ import annotations

import random
import re
from pathlib import Path

from hypothesis import strategies as st

from rmesh_nlp.io.problem_file import load_problem, template
from rmesh_nlp.io.problem_messages import ProblemFileError
from support.problem_files import SCALAR, VALID

ODD = [
    "0", "-1", "1e308", "1e-308", "nan", "inf", "true", '""', '"x"', '"1/0"', '"x**x"', "[]", "[[]]", "{}",
    "[1, 2]", "[1, 2, 3]", '["a", 1]', "1979-05-27", '"none"', '"free"', "{ relative = -1 }", "9" * 30,
    '"' + "(" * 300 + '"', '"__import__(\'os\')"', '"sqrt(x-2)"', '"log(y)"', '"left"', "'''\nx\n'''",
    '"\\u0000"', "3.5", "0x10", '"l-shape"\nh = 0.5', '"polygon"', '"plane-stress"', '"laplace"',
]  # fmt: skip
CHARACTERS = "abcxyz019.,=[]{}\"'#-+*/ \n\t\\é\u2028\0"


def mutate(text: str, rng: random.Random) -> str:
    """One to three random edits."""
    for _ in range(rng.randint(1, 3)):
        lines = text.split("\n")
        i, kind = rng.randrange(len(lines)), rng.randrange(8)
        if kind == 0:
            del lines[i]
        elif kind == 1:
            lines.insert(rng.randrange(len(lines)), lines[i])
        elif kind == 2:
            j = rng.randrange(len(lines))
            lines[i], lines[j] = lines[j], lines[i]
        elif kind in (3, 4) and "=" in lines[i]:
            lines[i] = lines[i].split("=")[0] + "= " + rng.choice(ODD)
        elif kind == 5 and "=" in lines[i]:
            lines[i] = rng.choice(["", "zz", "left", "x.y", '"a b"']) + lines[i][1:]
        elif kind == 6:
            lines[i] = re.sub(r"-?[0-9.]+", lambda _: rng.choice(ODD[:7]), lines[i], count=1)
        else:
            place = rng.randrange(len(lines[i]) + 1)
            lines[i] = lines[i][:place] + rng.choice(CHARACTERS) + lines[i][place + rng.randint(0, 1) :]
        text = "\n".join(lines) or "x"
    return text


BASES = (re.sub(r" +#.*", "", template("fuzz", "fuzz.toml")), VALID, SCALAR)


@st.composite
def edited(draw: st.DrawFn) -> str:
    """A valid problem file after a few edits; hypothesis makes those of a failure as few as it can."""
    return mutate(draw(st.sampled_from(BASES)), draw(st.randoms(use_true_random=False)))


def outcome(text: str, path: Path) -> str:
    """Whether a file with this text is "valid" or "refused" in one-line errors that name it."""
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    try:
        load_problem(path)
        return "valid"
    except ProblemFileError as error:
        lines = error.lines
    assert lines
    for line in lines:
        assert line.startswith(f"{path}: "), line
        assert len(line.splitlines()) == 1, line
    return "refused"
