"""Closed loop: decide anew twice a second while sampled cars move; draw what was driven and every plan on the way."""

import numpy as np

import riskplan as rp


def seen(track: rp.Track, times: np.ndarray) -> rp.GaussianMixturePrediction:
    """The true way of an agent, for the picture: known, so hardly spread."""
    at = np.column_stack([np.interp(times, track.times, track.positions[:, i]) for i in (0, 1)])
    certain = np.tile(1e-4 * np.eye(2), (len(times), 1, 1, 1))
    return rp.GaussianMixturePrediction(
        times, [1.0], at[:, None], certain, name=track.name, length=track.length, width=track.width
    )


def main() -> None:
    """Drive, say how it went, draw."""
    scenario = rp.load_scenario("riskplan/data/overtake.yaml")
    drive = rp.simulate(scenario, planner="rrt", bound=0.2, replan=0.5, time_limit=2.0, seed=4)
    print(
        f"{drive.status} after {drive.times[-1]:.1f} s and {drive.progress:.0f} m, {len(drive.cycles)} decisions: "
        + ", ".join(f"{drive.share(action):.0%} {action}" for action in ("kept", "planned", "fallback"))
        + f"; risk taken at most {drive.spent:.2g}"
    )
    plans = [  # every plan that was in force, in the colour of when it was made
        np.column_stack([c.states[:-1, :2], c.states[1:, :2], np.full(len(c.states) - 1, c.time)])
        for c in drive.cycles
        if c.action != "kept"
    ]
    driven = rp.Plan(
        "solved",
        drive.times,
        drive.states[:, :3],
        drive.states[:, 3],
        None,
        search=np.concatenate(plans),
    )
    true = scenario.with_agents([seen(track, scenario.times) for track in drive.tracks])
    anew = sum(c.action != "kept" for c in drive.cycles)
    title = f"closed loop: {len(drive.cycles)} decisions, {anew} new ways, by when they were made"
    rp.render(true, driven, "out/demos/closed-loop.html", title=title)
    rp.render(true, driven, "out/demos/closed-loop.png", time=2.0, title=title)


if __name__ == "__main__":
    main()
