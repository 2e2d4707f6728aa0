//! Energy tank of one end of a delayed coupling, and the counters that move energy to the other end's tank.
//!
//! Two tanks and the link between them are one store (Franken, Stramigioli, Misra, Secchi and Macchelli, "Bilateral
//! telemanipulation with time delays: a two-layer approach combining passivity and transparency", 2011): what a hand puts
//! in at one end may come out at the other, once. Each end tells how much it has given *in all*, as in the time-domain
//! passivity approach with delay (Ryu, Artigas and Preusche, "A passive bilateral control scheme for a teleoperator with
//! time-varying communication delay", 2010). A counter that only grows makes loss harmless, since the next datagram
//! carries what the lost one did, and makes duplicates and old datagrams worthless: only an increase is energy.
//!
//! Counters are whole nanojoules: both ends subtract the same numbers, and nothing is rounded into existence. Each end
//! also tells its *balance*, its level without what it has received. The balance and what was given to it add up to the
//! level that the other tank will have when all that is under way has arrived, so that a tank does not give twice for the
//! same need, however long the way is.

/// Nanojoules per joule.
const NANO: f64 = 1e9;
/// Most energy that a tank holds \[J\]: the work of pressing a device of 8 N 2.5 cm deep.
pub const LEVEL_MAX: f64 = 0.2;
/// Deepest debt of a tank \[J\].
pub const DEBT_MAX: f64 = 0.2;
/// Energy kept without decay \[J\]. Energy long lost to friction must not pay for an oscillation later.
pub const STORAGE: f64 = 0.06;
/// Time constant with which energy above [`STORAGE`] decays \[s\].
const STORAGE_SECS: f64 = 1.0;
/// Energy in each tank at the start \[J\]: the only energy in the coupling that no hand put in.
pub const CAPITAL: f64 = 4e-4;
/// Time constant with which two tanks become equal, apart from the delay between them \[s\].
const SHARING_SECS: f64 = 0.02;

/// What one end tells the other of its tank.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct EnergyAccount {
    /// Energy given to the other end since the start \[nJ\]; never decreases.
    pub given_nj: u64,
    /// Level without what was received from the other end \[nJ\].
    pub balance_nj: i64,
}

/// Energy that one end may put out \[J\].
#[derive(Clone, Debug)]
pub struct EnergyTank {
    level: f64,
    given_nj: u64,
    received_nj: u64,
    other_balance_nj: Option<i64>,
}

impl Default for EnergyTank {
    fn default() -> Self {
        Self { level: CAPITAL, given_nj: 0, received_nj: 0, other_balance_nj: None }
    }
}

impl EnergyTank {
    /// Energy that may be put out \[J\]; negative when more was put out than was there.
    pub fn level(&self) -> f64 {
        self.level
    }

    /// Adds energy that came in at the port, or takes what went out when negative \[J\]. NaN counts as nothing.
    pub fn put(&mut self, joules: f64) {
        if joules.is_finite() {
            self.level = (self.level + joules).clamp(-DEBT_MAX, LEVEL_MAX);
        }
    }

    /// Forgets a debt: nothing is left at the port that could pay it back as energy out of nothing.
    pub fn forgive(&mut self) {
        self.level = self.level.max(0.0);
    }

    /// Energy above [`STORAGE`] decays for a step.
    pub fn settle(&mut self, step_secs: f64) {
        if self.level > STORAGE {
            self.level = STORAGE + (self.level - STORAGE) * (1.0 - step_secs / STORAGE_SECS).max(0.0);
        }
    }

    /// Takes the other end's account, in any order: an older one changes nothing.
    pub fn receive(&mut self, other: &EnergyAccount) {
        if other.given_nj < self.received_nj {
            return;
        }
        let increase = other.given_nj - self.received_nj;
        self.received_nj = other.given_nj;
        self.put(increase as f64 / NANO);
        self.other_balance_nj = Some(other.balance_nj);
    }

    /// Gives the other end a step's part of what this tank has more than that one will have.
    pub fn share(&mut self, step_secs: f64) {
        let Some(balance) = self.other_balance_nj else { return };
        let other = (balance as f64 + self.given_nj as f64) / NANO;
        let more = 0.5 * (self.level.min(LEVEL_MAX) - other);
        let part = (more * (step_secs / SHARING_SECS).min(1.0)).min(self.level);
        if part > 0.0 {
            // Whole nanojoules, rounded down: the fraction stays here.
            let given = (part * NANO) as u64;
            self.given_nj = self.given_nj.saturating_add(given);
            self.level -= given as f64 / NANO;
        }
    }

    /// What the other end is told.
    pub fn account(&self) -> EnergyAccount {
        let level = (self.level * NANO) as i64;
        let received = i64::try_from(self.received_nj).unwrap_or(i64::MAX);
        EnergyAccount { given_nj: self.given_nj, balance_nj: level.saturating_sub(received) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use trocar_scene::random::SplitMix64;

    #[test]
    fn lost_repeated_and_reordered_accounts_create_no_energy() {
        let mut random = SplitMix64::new(1);
        let (mut here, mut there) = (EnergyTank::default(), EnergyTank::default());
        let mut on_the_way: Vec<(bool, EnergyAccount)> = Vec::new();
        let mut put = 2.0 * CAPITAL;
        for _ in 0..20_000 {
            let joules = 1e-4 * (random.unit() - 0.45);
            if here.level() + joules > 0.0 && here.level() + joules < STORAGE {
                here.put(joules);
                put += joules;
            }
            for (is_here, tank) in [(true, &mut here), (false, &mut there)] {
                tank.share(1e-3);
                on_the_way.push((is_here, tank.account()));
            }
            while on_the_way.len() > 200 {
                let (from_here, account) =
                    on_the_way.swap_remove(random.below(on_the_way.len() as u64) as usize);
                // One in three is lost, and one in three of the others comes again.
                let fate = random.below(3);
                if fate != 0 {
                    if from_here { there.receive(&account) } else { here.receive(&account) }
                }
                if fate == 1 {
                    on_the_way.push((from_here, account));
                }
            }
            assert!(here.level() + there.level() <= put + 1e-9, "{here:?} {there:?} of {put}");
            assert!(here.level() >= 0.0 && there.level() >= 0.0);
        }
        // What is under way arrives with the next account.
        there.receive(&here.account());
        here.receive(&there.account());
        assert!((here.level() + there.level() - put).abs() < 1e-6, "{here:?} {there:?} of {put}");
        assert!(there.level() > 1e-3, "the other end got its part: {there:?}");
    }

    #[test]
    fn two_tanks_become_equal_over_a_second_of_delay_without_giving_twice() {
        let (mut here, mut there) = (EnergyTank::default(), EnergyTank::default());
        here.put(0.03);
        let mut ways = [vec![EnergyAccount::default(); 500], vec![EnergyAccount::default(); 500]];
        for ms in 0..4_000 {
            for (tank, way) in [(&mut here, 0), (&mut there, 1)] {
                tank.share(1e-3);
                ways[way].push(tank.account());
                tank.receive(&ways[1 - way][ms]);
            }
            assert!(here.level() > 0.0149, "{ms} ms: {here:?}");
        }
        assert!((here.level() - there.level()).abs() < 1e-4, "{here:?} {there:?}");
    }

    #[test]
    fn nonsense_from_the_other_end_is_bounded() {
        let mut tank = EnergyTank::default();
        tank.put(f64::NAN);
        tank.put(f64::INFINITY);
        for account in [
            EnergyAccount { given_nj: u64::MAX, balance_nj: i64::MIN },
            EnergyAccount { given_nj: 5, balance_nj: i64::MAX },
        ] {
            tank.receive(&account);
            tank.share(1e-3);
            assert!(tank.level() <= LEVEL_MAX && tank.level() >= 0.0, "{tank:?}");
            tank.account();
        }
    }

    #[test]
    fn energy_above_what_is_kept_decays() {
        let mut tank = EnergyTank::default();
        tank.put(1.0);
        (0..10_000).for_each(|_| tank.settle(1e-3));
        assert!((tank.level() - STORAGE).abs() < 1e-4, "{tank:?}");
    }
}
