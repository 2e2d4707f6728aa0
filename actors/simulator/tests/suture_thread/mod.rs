//! Suture threads and their knots.

mod adaptive_segments;
mod budget;
mod closed;
mod contact;
mod controller;
mod cut;
mod discrete_elastic_rod;
mod elastic_body;
mod group;
mod held_back;
mod island;
mod knot;
mod knot_hold;
mod knot_slip_force;
mod knot_turns;
mod led_instrument;
mod led_onto_knot;
mod moving_obstacle;
mod soft_support;
mod suture_table;
mod tied_body;
