"""A format of trajectories: .xyz, which viewers of molecules read."""

import mrs
from mrs.output.atomic import replacing


@mrs.FORMATS.register
class XyzFile(mrs.BodyFile):
    """A text file of one body: per frame a number of points, the time, and the points."""

    name = "xyz"
    suffix = ".xyz"

    def times(self, sim):
        return [time for time, _ in frames_of(self.path)]

    def cut(self, sim):
        frames = [frame for frame in frames_of(self.path) if frame[0] <= sim.time]
        with replacing(self.path) as temporary:
            temporary.write_text("".join(text for _, text in frames))
        return frames[-1][0] if frames else None

    def write(self, sim):
        points, _, _ = sim.frame(self.body)
        rows = "".join("C {!r} {!r} {!r}\n".format(*row) for row in points.tolist())
        with self.path.open("a") as file:
            file.write(f"{len(points)}\ntime {sim.time!r}\n{rows}")

    @classmethod
    def summary(cls, path):
        found = frames_of(path)
        time, text = found[-1]
        return {"frames": len(found), "points": int(text.split()[0]), "time": time}


def frames_of(path):
    """Return time and text of each frame."""
    lines = path.read_text().splitlines(keepends=True) if path.exists() else []
    found = []
    while lines:
        count = 2 + int(lines[0])
        found.append((float(lines[1].split()[1]), "".join(lines[:count])))
        lines = lines[count:]
    return found
