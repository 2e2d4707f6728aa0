//! The station's copy of the host's scene.

use trocar_scene::{Commands, SimTime, Snapshot, Station};

use super::{StationMachine, StationNews};
use crate::control::{ClientState, SceneCounts, SceneKind};
use crate::session::host_members::digest_of;
use crate::session::own_rows::own_rows;

impl<A: Copy + PartialEq + Send + 'static> StationMachine<A> {
    /// Builds the scene that has arrived whole.
    pub(super) fn build(&mut self, now: SimTime, scene: &Snapshot, out: &mut Commands) {
        let Some(replica) = &mut self.replica else { return };
        let Some((manifest, bytes)) = self.built.take() else { return };
        if !bytes.is_empty()
            && let Err(error) = replica.apply(&bytes, out)
        {
            self.control.scene_failed(manifest.revision, &error.to_string(), now);
            return;
        }
        // The row tells when the batch has reached the scene.
        let me = out.me();
        let mark = scene.changed::<Station>(me);
        out.put(me, self.row());
        self.pending = Some((manifest, mark));
    }

    /// Tells the host what was built, once it is in the station's scene.
    pub(super) fn join(&mut self, now: SimTime, scene: &Snapshot) {
        let Some((manifest, mark)) = self.pending.take() else { return };
        let is_there = scene
            .iter::<Station>()
            .any(|(entity, _)| entity.station() == self.station() && scene.changed::<Station>(entity) > mark);
        let Some(replica) = self.replica.as_mut().filter(|_| is_there) else {
            self.pending = Some((manifest, mark));
            return;
        };
        let (entities, rows) = replica.row_counts();
        let counts = SceneCounts::of_rows(scene.registry(), entities, rows);
        let digest = match manifest.kind {
            SceneKind::Whole => replica.digest(scene).map(|digest| digest_of(&digest)),
            SceneKind::Missed { .. } => Ok(manifest.hash),
        };
        match digest {
            Ok(digest) => self.control.scene_built(manifest.revision, &counts, digest, now),
            Err(error) => self.control.scene_failed(manifest.revision, &error.to_string(), now),
        }
        if self.control.state() == ClientState::Running {
            // From here on what the station's own controllers write is left to them, at both ends.
            if let Some(columns) = &self.columns {
                replica.exclude(own_rows(columns, scene, &self.devices, self.moves));
            }
            if self.has_joined {
                self.tell(StationNews::Back);
            }
            self.has_joined = true;
        }
    }

    /// Puts what changed at the host into the station's scene: one delta at a time, since a batch holds no more than one,
    /// and all rows that have come.
    pub(super) fn follow(&mut self, now: SimTime, out: &mut Commands) {
        let Some(replica) = self.replica.as_mut() else { return };
        if self.control.state() != ClientState::Running || !out.is_empty() {
            return;
        }
        if let Some(delta) = self.deltas.pop_front() {
            if let Err(error) = replica.apply(&delta, out) {
                self.control.broke(&error.to_string(), now);
            }
            return;
        }
        for parcel in self.rows.drain(..) {
            // What cannot be read is counted; it came from the host, whose next datagram is newer.
            let _ = replica.receive_rows(parcel.payload(), out);
        }
        replica.put_vertices(out);
    }

    /// Among peers: asks the owner for bodies that differ, and writes what it has answered.
    pub(super) fn repair(&mut self, now: SimTime, scene: &Snapshot, out: &mut Commands) {
        let (Some(peer), Some(columns)) = (&mut self.peer, &self.columns) else { return };
        if self.control.state() != ClientState::Running {
            return;
        }
        peer.ask(now, scene, columns, &mut self.control);
        if let Some(entity) = peer.write(scene, columns, out) {
            self.tell(StationNews::Repaired(entity));
        }
    }
}
