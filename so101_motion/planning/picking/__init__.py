"""Pick and place: where the jaws can grip an item, and every stage as a plan.

``grasps.py`` lists grasps and what forbids them; ``pick_plan.py`` plans all stages.
"""
