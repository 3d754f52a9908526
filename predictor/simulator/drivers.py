"""Drivers that differ from each other, change their mind and are not exact.

Car following is the Intelligent Driver Model (Treiber, Hennecke, Helbing 2000), lane changes MOBIL (Kesting, Treiber,
Helbing 2007), both as in highway-env (Leurent 2018), with parameters drawn for each driver. Beyond that a driver slows
down before curves, yields, picks a new speed or another lane now and then, and errs: Ornstein-Uhlenbeck noise on
acceleration and yaw rate.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from highway_env import utils
from highway_env.road.lane import CircularLane, SineLane
from highway_env.road.road import LaneIndex, Road
from highway_env.vehicle.behavior import IDMVehicle

from checkers.validate import Array

MAX_SPEED = 45.0
MAX_YAW_RATE = 1.0
TRUCKS = 0.1
# [m/s²]
HARDEST = 7.0
# seconds between changes of mind, on average
NEW_SPEED, SLOW_DOWN, OTHER_LANE = 12.0, 45.0, 30.0
# standard deviation and correlation time of the errors: acceleration [m/s²], yaw rate [rad/s]
ACCELERATION_NOISE, YAW_NOISE = (0.25, 1.5), (0.008, 0.7)


class Driver(IDMVehicle):  # type: ignore[misc]  # highway-env is untyped
    """A vehicle with its driver, moving along its heading: a Dubins car, so its controls explain its positions.

    Attributes:
        control: (2,) acceleration [m/s²] and yaw rate [rad/s] of the last step, as they took effect.
        limit: speed limit of the road [m/s].
        yielding: seconds it still gives way.
        braking: what that takes [m/s²].
    """

    position: Array

    def __init__(self, road: Road, lane: LaneIndex, station: float, limit: float, rng: np.random.Generator) -> None:
        where = road.network.get_lane(lane)
        super().__init__(road, where.position(station, 0.0), where.heading_at(station), 0.0, target_lane_index=lane)
        self.lane_index, self.lane, self.limit, self.rng = lane, where, limit, rng
        self.control: Array = np.zeros(2)
        self.yielding, self.braking = 0.0, 0.0
        self._errors, self._slow_for = np.zeros(2), 0.0
        self._draw_body()
        self._draw_temper()
        self.speed = min(self._eagerness * limit, self._curve_speed())
        self.target_speed = self.speed

    def act(self, action: Any = None) -> None:
        """Decide acceleration and steering."""
        self._change_mind()
        wanted = self._eagerness * self.limit * (self._slowness if self._slow_for > 0 else 1.0)
        self.target_speed = max(min(wanted, self._curve_speed()), 0.5)
        super().act()
        if self.yielding > 0:
            self.action["acceleration"] = min(self.action["acceleration"], -self.braking)

    def give_way(self, seconds: float, distance: float) -> None:
        """Brake comfortably, or as hard as it takes to stop within `distance` [m]."""
        needed = self.speed**2 / (2 * max(distance, 0.5))
        comfortable = 0.7 * abs(self.COMFORT_ACC_MIN)
        self.yielding, self.braking = seconds, min(max(needed, comfortable), HARDEST)

    def step(self, dt: float) -> None:
        """Move, and remember how."""
        self.timer += dt
        self.yielding, self._slow_for = self.yielding - dt, self._slow_for - dt
        for i, (spread, memory) in enumerate((ACCELERATION_NOISE, YAW_NOISE)):
            keep = np.exp(-dt / memory)
            self._errors[i] = keep * self._errors[i] + spread * np.sqrt(1 - keep**2) * self.rng.standard_normal()
        # nobody fidgets or turns while standing
        rolling = min(self.speed / 3.0, 1.0)
        acceleration = float(self.action["acceleration"]) + rolling * self._errors[0]
        acceleration = float(np.clip(acceleration, -self.speed / dt, (MAX_SPEED - self.speed) / dt))
        yaw_rate = float(self.action["steering"]) + rolling * self._errors[1]
        self.position = self.position + self.speed * dt * np.array([np.cos(self.heading), np.sin(self.heading)])
        self.heading += yaw_rate * dt
        self.speed = max(self.speed + acceleration * dt, 0.0)
        self.control = np.array([acceleration, yaw_rate])
        self.on_state_update()

    def steering_control(self, target_lane_index: LaneIndex) -> float:
        """The yaw rate [rad/s] that follows a lane: from lateral offset to lateral speed to heading to yaw rate."""
        lane = self.road.network.get_lane(target_lane_index)
        station, offset = lane.local_coordinates(self.position)
        speed = max(self.speed, 1.0)
        sideways = np.clip(-self.KP_LATERAL * offset, -self._lateral_speed, self._lateral_speed)
        wanted = lane.heading_at(station + self.speed * self.TAU_PURSUIT)
        wanted += np.clip(np.arcsin(np.clip(sideways / speed, -1.0, 1.0)), -np.pi / 4, np.pi / 4)
        most = min(1.5 * self._lateral_comfort / speed, MAX_YAW_RATE) * min(self.speed, 1.0)
        return float(np.clip(self.KP_HEADING * utils.wrap_to_pi(wanted - self.heading), -most, most))

    def desired_gap(self, ego_vehicle: Any, front_vehicle: Any = None, projected: bool = True) -> float:
        """Between the centres [m]: highway-env's takes every vehicle for equally long."""
        longer = float(front_vehicle.LENGTH - self.LENGTH) / 2
        return float(super().desired_gap(ego_vehicle, front_vehicle, projected)) + longer

    def on_state_update(self) -> None:
        """The lane it is on now: one of those around the last, instead of a search through the whole map."""
        network = self.road.network
        around = {self.lane_index, self.target_lane_index, *network.side_lanes(self.lane_index)}
        for index in (self.lane_index, self.target_lane_index):
            following = network.graph.get(index[1], {})
            around.update((index[1], to, i) for to, lanes in following.items() for i in range(len(lanes)))
        near = sorted(around)
        distances = [network.get_lane(i).distance_with_heading(self.position, self.heading) for i in near]
        self.lane_index = near[int(np.argmin(distances))]
        self.lane = network.get_lane(self.lane_index)

    @property
    def astray(self) -> bool:
        """Whether it has left the road."""
        return bool(self.lane.distance(self.position) > 6.0)

    @property
    def arrived(self) -> bool:
        """Whether it is at the end of the map."""
        return self.lane_index[1] not in self.road.network.graph and bool(self.lane.after_end(self.position))

    def _draw_body(self) -> None:
        truck = self.rng.random() < TRUCKS
        low, high = ((7.0, 12.0), (2.3, 2.5)) if truck else ((3.9, 5.2), (1.7, 2.0))
        self.LENGTH, self.WIDTH = float(self.rng.uniform(*low)), float(self.rng.uniform(*high))
        self.diagonal = float(np.hypot(self.LENGTH, self.WIDTH))
        self.body = "truck" if truck else "car"

    def _draw_temper(self) -> None:
        draw = self.rng.uniform
        self.TIME_WANTED, self.DISTANCE_WANTED = draw(0.8, 2.0), self.LENGTH + draw(1.5, 4.0)
        self.COMFORT_ACC_MAX, self.COMFORT_ACC_MIN = draw(1.2, 3.0), -draw(2.0, 4.0)
        self.DELTA = draw(3.5, 4.5)
        self.POLITENESS, self.LANE_CHANGE_MIN_ACC_GAIN = draw(0.0, 0.5), draw(0.1, 0.5)
        self.LANE_CHANGE_MAX_BRAKING_IMPOSED = draw(1.5, 3.0)
        heading, lateral = draw(0.25, 0.45), draw(1.0, 2.0)
        self.KP_HEADING, self.KP_LATERAL, self.TAU_PURSUIT = 1 / heading, 1 / lateral, heading
        self._eagerness, self._slowness = self._draw_eagerness(), 1.0
        self._lateral_comfort, self._lateral_speed = draw(2.0, 4.0), draw(0.8, 1.8)

    def _draw_eagerness(self) -> float:
        return float(np.clip(self.rng.normal(1.0, 0.12), 0.7, 1.3))

    def _change_mind(self, dt: float = 0.1) -> None:
        speed, slow, lane = self.rng.random(3) * (NEW_SPEED, SLOW_DOWN, OTHER_LANE) < dt
        if speed:
            self._eagerness = self._draw_eagerness()
        if slow:
            self._slowness, self._slow_for = self.rng.uniform(0.3, 0.8), self.rng.uniform(1.5, 4.0)
        if lane and self.lane_index == self.target_lane_index and self.speed > 3.0 and self.enable_lane_change:
            self._take_another_lane()

    def _take_another_lane(self) -> None:
        sides = self.road.network.side_lanes(self.lane_index)
        sides = [i for i in sides if self.road.network.get_lane(i).is_reachable_from(self.position)]
        if not sides:
            return
        side = sides[int(self.rng.integers(len(sides)))]
        front, rear = self.road.neighbour_vehicles(self, side)
        imposed = min(self.acceleration(self, front), self.acceleration(rear, self) if rear else 0.0)
        if imposed > -self.LANE_CHANGE_MAX_BRAKING_IMPOSED:
            self.target_lane_index = side

    def _curve_speed(self) -> float:
        """The speed from which it is still comfortable to take this lane and the next of the route [m/s]."""
        lane = self.road.network.get_lane(self.target_lane_index)
        left = lane.length - lane.local_coordinates(self.position)[0]
        speed = np.sqrt(self._lateral_comfort * radius(lane))
        following = self._next_lane()
        if following is not None:
            ahead = self._lateral_comfort * radius(following) + 2 * 0.6 * abs(self.COMFORT_ACC_MIN) * max(left, 0.0)
            speed = min(speed, np.sqrt(ahead))
        return float(speed)

    def _next_lane(self) -> Any | None:
        node = self.target_lane_index[1]
        for start, end, index in self.route or ():
            if start == node:
                return self.road.network.get_lane((start, end, index or 0))
        return None


def radius(lane: Any) -> float:
    """The smallest radius of a lane's curve [m]."""
    if isinstance(lane, CircularLane):
        return float(lane.radius)
    if isinstance(lane, SineLane):
        return float(1.0 / max(abs(lane.amplitude) * lane.pulsation**2, 1e-9))
    return 1e9
