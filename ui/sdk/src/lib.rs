//! The facade that users depend on: the standard controllers wired to scenarios.
