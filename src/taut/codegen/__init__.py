"""Every target of a traced graph: native code, the call path, CasADi."""
