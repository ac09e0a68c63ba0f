"""The stories of docs/stories.md, each of which runs once, in test_task_stories.py."""

from __future__ import annotations

STORIES = (
    "panda_pushed",
    "xarm7_directions",
    "ur10_led",
    "ur10_led_drives",
    "two_arms",
    "wrist_alignment",
    "policy_10hz",
    "panda_presses",
    "panda_erases",
    "panda_writes",
    "panda_writes_round",
    "panda_polishes",
    "cabinet_door",
    "two_arms_bar",
    "wheel_tool",
)
