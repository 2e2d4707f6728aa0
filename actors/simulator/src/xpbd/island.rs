//! Bodies that are stepped as one problem, and everybody who takes part in their step.

use trocar_dynamics::coupling::external_nodes::{ExternalNodes, ExternalNodesState};
use trocar_dynamics::particles::StepError;

use super::{Xpbd, XpbdConfig, XpbdInput};

/// A body that is stepped together with others.
#[derive(Debug)]
pub struct Member<'a> {
    /// The body.
    pub body: &'a mut Xpbd,
    /// What acts on it; its own company does not count.
    pub input: XpbdInput<'a>,
}

/// Steps bodies by `dt` seconds that ties join, as one problem: in as many parts and iterations as the one has that has most.
/// Ties name nodes through all bodies, each body having a spare one behind its own.
///
/// # Errors
/// The number of the body, and what is wrong with its input or its result. With its input nothing has been stepped, and
/// nothing has become of anybody; of a result that cannot be that body is as it was.
pub fn step_together(
    dt: f64,
    members: &mut [Member<'_>],
    company: &ExternalNodes<'_>,
    scratch: &mut ExternalNodesState,
) -> Result<(), (usize, StepError)> {
    scratch.forget();
    if !(dt > 0.0 && dt.is_finite()) {
        return Err((0, StepError::Time(dt)));
    }
    let mut nodes = 0;
    for (index, member) in members.iter().enumerate() {
        member.body.check_input(&member.input).map_err(|error| (index, error))?;
        nodes += member.body.mobility.len() + 1;
    }
    company.check(nodes).map_err(|error| (0, error))?;
    members.iter_mut().for_each(|member| member.body.prepare(dt, &member.input));
    company.prepare(scratch);
    let most = |of: fn(&XpbdConfig) -> u32| members.iter().map(|member| of(&member.body.config)).max();
    let (parts, iterations) = (most(|config| config.parts), most(|config| config.iterations));
    let parts = parts.unwrap_or(1);
    let h = dt / f64::from(parts);
    // Nobody else's nodes: nothing to gather in every part.
    let has_company = !(company.guests.is_empty() && company.ties.is_empty());
    for index in 1..=parts {
        if has_company {
            company.begin(all_places(members), scratch);
        }
        members.iter_mut().for_each(|member| member.body.predict(h, &member.input));
        company.predict(h, scratch);
        for _ in 0..iterations.unwrap_or(1) {
            members.iter_mut().for_each(|member| member.body.sweep(h, h * f64::from(index), &member.input));
            if has_company {
                company.project(h, all_places(members), scratch);
            }
        }
        members.iter_mut().for_each(|member| member.body.settle(h, &member.input));
        if has_company {
            company.end(h, all_places(members), scratch, f64::from(parts));
        }
    }
    let mut done = Ok(());
    for (index, member) in members.iter_mut().enumerate() {
        let finished = member.body.finish(dt, &member.input).map_err(|error| (index, error));
        done = done.and(finished);
    }
    done
}

/// Where all nodes are, the spare ones of each body behind its own.
fn all_places<'a>(members: &'a mut [Member<'_>]) -> Vec<&'a mut [[f64; 4]]> {
    members.iter_mut().map(|member| &mut member.body.scratch.places[..]).collect()
}
