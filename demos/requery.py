"""One roadmap, asked anew as predictions change: the car ahead first keeps its lane, then seems to move over."""

from time import perf_counter

import numpy as np
from PIL import Image

import riskplan as rp

TIMES = np.arange(0.0, 6.01, 0.1)
ROAD = np.array([[-40.0, -1.75], [160.0, -1.75], [160.0, 8.75], [-40.0, 8.75]])
LANES = [np.array([[-40.0, y], [160.0, y]]) for y in (0.0, 3.5, 7.0)]


def ahead(left: float, right: float) -> rp.GaussianMixturePrediction:
    """A slow car in the middle lane that keeps it, or changes to the left or right with these weights."""
    ease = np.clip(TIMES / 3.0, 0.0, 1.0) ** 2 * (3.0 - 2.0 * np.clip(TIMES / 3.0, 0.0, 1.0))
    along = 26.0 + 7.0 * TIMES
    means = np.stack([np.column_stack([along, 3.5 + 3.5 * side * ease]) for side in (0, 1, -1)], axis=1)
    spread = np.stack([np.diag([0.25 + 0.15 * t, 0.15 + 0.05 * t]) ** 2 for t in TIMES])
    return rp.GaussianMixturePrediction(
        TIMES,
        [1 - left - right, left, right],
        means,
        np.repeat(spread[:, None], 3, axis=1),
        name="ahead",
        length=4.6,
        width=1.9,
    )


def main() -> None:
    """Build once, ask three times, draw the answers below each other."""
    scenario = rp.Scenario(
        name="roadmap",
        start=rp.State(0.0, 3.5, 0.0, 14.0),
        goal=rp.Goal.at(76.0, 3.5, radius=8.0, heading=0.0, heading_tolerance=0.25, time=(4.5, 6.0)),
        bounds=(-10.0, -1.75, 120.0, 8.75),
        agents=[ahead(0.05, 0.05)],
        ego=rp.EgoCover.discs(4.6, 1.9, relative_heading=0.0),
        vehicle=rp.KinematicCar(length=4.6, width=1.9),
        drivable=[ROAD],
        lanes=LANES,
    )
    began = perf_counter()
    planner = rp.Prm(size=900, roadmap=rp.Roadmap.build(scenario, size=900, seed=3))
    print(f"roadmap built in {perf_counter() - began:.2f} s")
    views = []
    beliefs = [
        ("keeps its lane", 0.004, 0.004),
        ("may move to the left", 0.50, 0.0),
        ("may move to the right", 0.0, 0.50),
    ]
    for i, (belief, left, right) in enumerate(beliefs):
        now = scenario.with_agents([ahead(left, right)])
        began = perf_counter()
        plan = rp.plan(now, planner=planner, checker="exact", bound=0.01, time_limit=5.0, seed=0)
        print(f"{belief}: {plan.message} ({perf_counter() - began:.2f} s)")
        title = f"the car ahead {belief}"
        views.append(rp.render(now, plan, f"out/demos/requery-{i}.png", view="top", title=title, size=(1200, 300)))
    images = [Image.open(view) for view in views]
    sheet = Image.new("RGB", (images[0].width, sum(image.height for image in images)))
    for i, image in enumerate(images):
        sheet.paste(image, (0, i * image.height))
    sheet.save("out/demos/requery.png")


if __name__ == "__main__":
    main()
