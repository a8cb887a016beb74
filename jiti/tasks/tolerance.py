"""How far a predicate's measure may go. Geometry, frame, and why that far: `jiti.runtime.sim.predicates`."""

TOLERANCE = {
    "IsGrasping": 0.0,  # fingers that do not touch it
    "IsOnBottomOf": 0.020,  # m over where it rests
    "IsPreciselyOn": 0.010,  # m between the middles, seen from above
    "IsOrientationAligned": 0.10,  # rad to the walls
    "PositionUnchanged": 0.005,  # m since the start, with `ARM_M` a radian
    "MovesGently": 0.10,  # m/s or rad/s of a joint
}
TILT_RAD = 0.1
"""For IsPreciselyOn: how far what pointed up may lean."""
ARM_M = 0.05
"""For PositionUnchanged: what a turn by a radian counts as."""
