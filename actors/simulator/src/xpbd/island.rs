//! Islands: several bodies stepped as one problem, with the external nodes and ties that couple them.

use trocar_dynamics::coupling::external_nodes::{ExternalNodes, ExternalNodesState};
use trocar_dynamics::particles::StepError;

use super::{PARTS_MAX, Xpbd, XpbdConfig, XpbdInput};

/// A body of an island.
#[derive(Debug)]
pub struct Member<'a> {
    /// The body.
    pub body: &'a mut Xpbd,
    /// Its inputs; their `external_nodes` is ignored.
    pub input: XpbdInput<'a>,
}

/// Steps bodies coupled by ties by `dt` seconds as one problem, with the largest number of substeps and iterations of
/// any. Ties number the nodes through all bodies, with one spare node after those of each.
///
/// # Errors
/// The index of the body, and what is wrong with its input or result. After invalid input, no body has changed; after
/// an invalid result, that body is unchanged.
pub fn step_together(
    dt: f64,
    members: &mut [Member<'_>],
    external_nodes: &ExternalNodes<'_>,
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
    external_nodes.check(nodes).map_err(|error| (0, error))?;
    external_nodes.prepare(scratch);
    // Without external nodes there is nothing to gather in each substep.
    let has_company = !(external_nodes.ghost_nodes.is_empty() && external_nodes.ties.is_empty());
    if let [Member { body, input }] = members
        && !has_company
        && input.direct
        && body.has_network()
    {
        return body.step_directly(dt, input).map_err(|error| (0, error));
    }
    members.iter_mut().for_each(|member| member.body.prepare(dt, &member.input));
    let most = |of: fn(&XpbdConfig) -> u32| members.iter().map(|member| of(&member.body.config)).max();
    let (parts, iterations) = (most(|config| config.parts), most(|config| config.iterations));
    let wanted = members.iter().map(|member| member.input.parts_min).max().unwrap_or(0);
    let parts = parts.unwrap_or(1).max(wanted).min(PARTS_MAX);
    let h = dt / f64::from(parts);
    for index in 1..=parts {
        if has_company {
            external_nodes.begin(all_places(members), scratch);
        }
        members.iter_mut().for_each(|member| member.body.predict(h, &member.input));
        external_nodes.predict(h, scratch);
        for _ in 0..iterations.unwrap_or(1) {
            members.iter_mut().for_each(|member| member.body.sweep(h, h * f64::from(index), &member.input));
            if has_company {
                external_nodes.project(h, all_places(members), scratch);
            }
        }
        members.iter_mut().for_each(|member| member.body.settle(h, &member.input));
        if has_company {
            external_nodes.end(h, all_places(members), scratch, f64::from(parts));
        }
    }
    let mut done = Ok(());
    for (index, member) in members.iter_mut().enumerate() {
        let finished = member.body.finish(dt, &member.input).map_err(|error| (index, error));
        done = done.and(finished);
    }
    done
}

/// Positions of all nodes, with the spare node of each body after its own.
fn all_places<'a>(members: &'a mut [Member<'_>]) -> Vec<&'a mut [[f64; 4]]> {
    members.iter_mut().map(|member| &mut member.body.scratch.places[..]).collect()
}
