"""Agents for dependence "persistent" where a scenario does not say how their errors depend over time."""

from __future__ import annotations

from checkers import GaussianMixturePrediction, InputError, persistent
from riskplan.scene import Scenario


def persisting(scenario: Scenario, dependence: str) -> tuple[Scenario, str]:
    """For "persistent": agents without factors are taken to err all the way alike, and a note says how many are.

    Raises:
        InputError: for an agent that is no Gaussian mixture.
    """
    if dependence != "persistent":
        return scenario, ""
    agents, silent = [], 0
    for i, agent in enumerate(scenario.agents):
        if not isinstance(agent, GaussianMixturePrediction):
            raise InputError(
                f"agents[{i}]: dependence 'persistent' expects a Gaussian mixture, got {type(agent).__name__}"
            )
        silent += agent.factors is None
        agents.append(persistent(agent) if agent.factors is None else agent)
    note = f"{silent} of {len(agents)} agents carry no factors: their errors are taken to persist" if silent else ""
    return scenario.with_agents(agents), note
