"""Design: gains from a specification, judged on the exact sampled loop; what was asked, got and met."""
