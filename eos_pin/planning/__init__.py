"""Planning of the self-motion: `manifold.self_motion_manifold`, `manifold.SelfMotionManifold`."""
