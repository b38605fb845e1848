from pathlib import Path

f = Path("rmesh_nlp/mpcc/rescues.py")
s = f.read_text()
a = s.index("    options, lifted = run.options, run.lifted\n")
b = s.index("def _from_phase_one")
s = (
    s[:a]
    + """    if any(path.ended for path in paths) or _from_phase_one(run, paths, z0):
        return not any(path.ended for path in paths)
    for x in islice(moved_starts(run.lifted.source, x0, run.options.seed), run.options.moves):
        if any(path.ended for path in paths):
            break
        paths.append(Path())
        follow(run, paths[-1], run.lifted.start(x, run.p[:-1]), run.options.t0, dependent=True)
    return False


"""
    + s[b:]
)
f.write_text(s)
