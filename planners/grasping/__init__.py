"""How can an object be grasped? Grasp poses, base poses and arm configurations."""
