"""From measurements to an arm's parameters: tau = Y(q, dq, ddq) beta + friction, by weighted least squares."""
