//! One touched taxel from reading to reading, and where the base has been meanwhile.

use super::{BLIND_RETREAT_M, BLIND_RETREAT_S, BarrierSettings, FoamCurve, TaxelSample};
use crate::scalar::{Scalar, of};

/// Steps of odometry that are kept: at 1 kHz 128 ms, older than any reading that a law is given.
const KEPT: usize = 128;
/// Readings further apart than this say nothing of a speed, s.
const APART_S: f64 = 0.2;
/// Time after a release in which the foam is still recovering, and a light touch is told from none later, s. So long the base
/// goes no further than where it stood.
pub const RECOVERS_S: f64 = 2.0;
/// Then it goes no further than where it pressed who touched until it has stood there for so long, s: what a threshold hides
/// of a touch that is come upon, some of so many frames show of one that rests;
const LOOKS_S: f64 = 0.5;
/// it stands there from so little before it on, m.
const THERE_M: f64 = 0.2e-3;
/// For as long again it goes on at this share of the speed at which it met somebody, but no slower than [`SLOWEST_M_S`].
const AGAIN: f64 = 0.5;
/// Speed below which a base stands, m/s: it meets nobody, who touches it has come.
pub const SLOWEST_M_S: f64 = 0.005;
/// Readings of which an estimate of a speed rests on what was assumed.
const ASSUMED: u8 = 2;
/// As far below 0 as noise takes the estimate of a speed, m/s: cut at 0, its mean would lie above it.
const NOISE_M_S: f64 = 0.05;

/// Displacement of the base in the last steps: the integral of its measured velocity in its own axes. Over the age of a
/// reading these hardly turn.
#[derive(Clone, Debug)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Odometry<T> {
    #[cfg_attr(feature = "serde", serde(with = "serde_big_array::BigArray"))]
    places: [[T; 3]; KEPT],
    head: usize,
    known: usize,
    dt_s: T,
}

impl<T: Scalar> Odometry<T> {
    pub(super) fn new() -> Self {
        Self { places: [[T::zero(); 3]; KEPT], head: 0, known: 1, dt_s: T::one() }
    }

    pub(super) fn advance(&mut self, velocity: &[T; 3], dt_s: T) {
        let last = self.places[self.head];
        self.head = (self.head + 1) % KEPT;
        self.places[self.head] = core::array::from_fn(|j| last[j] + velocity[j] * dt_s);
        self.known = (self.known + 1).min(KEPT);
        self.dt_s = dt_s;
    }

    pub(super) fn now(&self) -> &[T; 3] {
        &self.places[self.head]
    }

    /// The place at the step nearest to `age_s` ago, or the oldest that is known.
    pub(super) fn at_age(&self, age_s: T) -> &[T; 3] {
        let steps = nalgebra::try_convert((age_s / self.dt_s - of(0.5)).ceil()).unwrap_or(0.0);
        #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "saturates")]
        let back = (steps as usize).min(self.known - 1);
        &self.places[(self.head + KEPT - back) % KEPT]
    }
}

/// A reading, with what belongs to it.
pub(super) struct Felt<T> {
    pub(super) sample: TaxelSample<T>,
    /// A touch too light for a reading.
    pub(super) light: bool,
    /// Force on all of the body, N, by the foam, and the plates like this one that it presses besides.
    pub(super) body_n: T,
    pub(super) plates: T,
    /// Outward displacement of the base when the reading was taken, m.
    pub(super) way: T,
}

/// State of one taxel's contact.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Track<T> {
    /// Readings since the touch began; 0: nothing touches.
    readings: u8,
    /// One of them was no light touch.
    firm: bool,
    /// Compression at the last reading, m, the reading itself and the force on all of the body, N, and the way outward
    /// that the base had gone then, m.
    depth: T,
    force: T,
    body_n: T,
    way: T,
    /// Plates like this one that the body presses.
    plates: T,
    /// Estimate of the person's speed, m/s; after a release what is still remembered of it.
    person: T,
    /// Fastest that the person came to a late base, m/s, as it is remembered.
    fastest: T,
    /// Rate of the compression, m/s, and yield rate of the softest body that is assumed, m/s.
    rate: T,
    yields: T,
    /// Time since the last reading was taken, s.
    since: T,
    /// Time since the release, s.
    released: T,
    /// Speed outward before the last reading without even a light touch, m/s.
    approach: T,
    /// Speed at which the base met who touches, or did until a moment ago, m/s: 0 if it stood.
    met: T,
    /// Way outward where the readings ended that could be believed, m.
    blind_from: Option<T>,
    /// Way outward beyond which the base does not go for who touches here or beside it, m, and time since somebody did, s.
    far: Option<T>,
    near: T,
    /// True if the base was here, and the time for which it has stood here since, s.
    here: bool,
    looked: T,
}

impl<T: Scalar> Track<T> {
    /// Nothing touches, and nothing has for long.
    pub(super) fn none() -> Self {
        let (zero, long_ago) = (T::zero(), of(1e6));
        Self {
            readings: 0,
            firm: false,
            depth: zero,
            force: zero,
            body_n: zero,
            way: zero,
            plates: T::one(),
            person: zero,
            fastest: zero,
            rate: zero,
            yields: zero,
            since: long_ago,
            released: long_ago,
            approach: zero,
            met: of(f64::INFINITY),
            blind_from: None,
            far: None,
            near: long_ago,
            here: false,
            looked: zero,
        }
    }

    pub(super) fn touched(&self) -> bool {
        self.readings > 0
    }

    /// Returns true if a touch ended so recently that it may go on undetected, or if the base has not looked yet.
    pub(super) fn was_touched(&self) -> bool {
        let looks = self.here && self.far.is_some();
        self.released < of(if looks { 2.0 * RECOVERS_S } else { RECOVERS_S })
    }

    /// Returns true if the person came to a base that stood.
    fn came(&self) -> bool {
        self.met < of(SLOWEST_M_S)
    }

    /// Plates like this one that the body presses, ≥ 1.
    pub(super) const fn plates(&self) -> T {
        self.plates
    }

    pub(super) fn person_m_s(&self) -> T {
        (self.person + self.yields).max(self.fastest)
    }

    /// Returns true if the following step takes `sample` in as a reading of its own.
    pub(super) fn is_new(&self, sample: Option<TaxelSample<T>>, dt_s: T) -> bool {
        sample.is_some_and(|sample| sample.age_s - of::<T>(0.5) * dt_s < self.since)
    }

    /// Time passes, and the base is `way` outward. Of the speed at a release, and of the fastest, these shares are forgotten.
    pub(super) fn wait(&mut self, dt_s: T, [forgotten, of_fastest]: [T; 2], way: T) {
        self.since += dt_s;
        self.released += dt_s;
        self.near += dt_s;
        if self.is_there(way) {
            self.looked += dt_s;
        }
        let looks = self.here && self.looked < of(LOOKS_S) && self.near < of(2.0 * RECOVERS_S);
        if self.near > of(RECOVERS_S) && !looks {
            (self.far, self.here) = (None, false);
        }
        self.fastest -= self.fastest * of_fastest;
        if !self.touched() {
            self.person -= self.person * forgotten;
        }
    }

    /// There is no reading that can be believed; the base is `way` outward.
    pub(super) fn lose(&mut self, way: T) {
        if self.blind_from.is_none() {
            self.blind_from = Some(way);
        }
    }

    /// Somebody touches `here` or beside it; the base is `way` outward where it goes no further from now on.
    pub(super) fn hold(&mut self, way: Option<T>, here: bool) {
        (self.near, self.looked) = (T::zero(), T::zero());
        self.here |= here;
        self.far = self.far.or(way);
    }

    /// The base stands `way` outward to look whether somebody still touches beside it: held over the next step.
    pub(super) fn stay(&mut self, way: T, dt_s: T) {
        self.near = self.near.min(of::<T>(RECOVERS_S) - (dt_s + dt_s));
        self.far = self.far.or(Some(way));
    }

    /// Returns true if the base looks, `way` outward, for a person here who has not been detected for long.
    pub(super) fn looks(&self, way: T) -> bool {
        self.here && self.near > of(RECOVERS_S) && self.is_there(way)
    }

    fn is_there(&self, way: T) -> bool {
        self.far.is_some_and(|far| way > far - of(THERE_M))
    }

    /// The base met who touches at this speed outward, m/s: the least of them, if it was here a moment ago.
    fn meet(&mut self, speed: T) {
        self.met = if self.here { self.met.min(speed.max(of(SLOWEST_M_S))) } else { speed.max(T::zero()) };
    }

    /// Way outward beyond which the base does not go, m.
    pub(super) const fn far(&self) -> Option<T> {
        self.far
    }

    /// The reading can be believed.
    pub(super) fn find(&mut self) {
        self.blind_from = None;
    }

    /// Takes in a reading of its own.
    pub(super) fn take(&mut self, settings: &BarrierSettings, felt: &Felt<T>) {
        let Felt { sample, light, body_n, plates, way } = *felt;
        self.find();
        let interval = self.since - sample.age_s;
        self.since = sample.age_s;
        if sample.force_n < of(settings.touch_n) && !self.touched() {
            // what a first reading is measured against
            if light {
                self.meet(self.approach);
            } else {
                self.approach = (way - self.way) / interval;
            }
            self.way = way;
            return;
        }
        if sample.force_n < of(settings.touch_n) {
            // one reading's speed was assumed and not seen, and light ones may have been a false alarm
            let seen = self.readings > 1 && self.firm;
            let person = if seen { self.person_m_s() } else { T::zero() };
            let Self { fastest, since, met, far, near, here, looked, .. } = *self;
            let released = T::zero();
            *self =
                Self { way, since, released, met, person, fastest, far, near, here, looked, ..Self::none() };
            return;
        }
        let depth = settings.foam.depth_m(body_n);
        let known = self.released < of(settings.forget_s);
        let assumed = if known { self.person } else { of(settings.first_speed_m_s) };
        if interval < of(APART_S) {
            self.estimate(settings, depth, way, interval);
        }
        if !self.touched() {
            self.person = self.person.max(assumed);
            // a light touch may have stopped the base before there was a reading
            self.meet(((way - self.way) / interval).max(self.approach));
        }
        self.readings = self.readings.saturating_add(1);
        // a base that obeys at once takes no light touch for a reading
        self.firm |= !light || settings.remember_s <= 0.0;
        // what a late base does shows in its readings after so long that a person who slows down and one whom it leaves look alike
        if settings.remember_s > 0.0 && self.readings > ASSUMED && self.firm {
            self.fastest = self.fastest.max(self.person + self.yields);
        }
        (self.depth, self.force, self.body_n, self.way) = (depth, sample.force_n, body_n, way);
        self.plates = plates;
    }

    /// The person's speed: what the compression has gained that the base has not gone.
    fn estimate(&mut self, settings: &BarrierSettings, depth: T, way: T, interval: T) {
        let before = if self.touched() {
            self.depth
        } else if self.was_touched() {
            // who was touched a moment ago may still be, by what the threshold hides
            depth.min(settings.reading.depth_m(of(settings.hidden_n)))
        } else {
            T::zero()
        };
        let rate = (depth - before) / interval;
        let raw = rate - (way - self.way) / interval;
        // Readings are averaged. What the first one had to assume is replaced by the second where the base itself moved, and
        // counts like any other where it stood: who touches it then has come.
        let recent = interval / interval.max(of(settings.speed_s));
        let seen = self.readings.saturating_add(u8::from(self.came())).max(1);
        let weight = recent.max(T::one() / of(f64::from(seen)));
        let person = self.person + weight * (raw - self.person);
        self.person = person.clamp(of(-NOISE_M_S), of(settings.fastest_person_m_s));
        self.rate += weight * (rate - self.rate);
        // of a soft body the foam shows only a part of how it comes; what the base itself closes says nothing of it, and
        // noise alone, of which only what lies above 0 counts, shows nearly half its own size
        let noise = of::<T>(0.5 * settings.speed_noise_m_s);
        let seen = (self.rate.min(self.person) - noise).max(T::zero());
        let yields = seen * settings.foam.slope_n_m(depth) / of(settings.softest_n_m);
        self.yields = yields.min(of::<T>(settings.fastest_person_m_s) - self.person);
    }

    /// Compression now, m, the base being `way` outward.
    pub(super) fn depth_now(&self, way: T) -> T {
        self.depth + way - self.way + self.person_m_s() * self.since
    }

    /// Force that a law may count on at this compression, N: a reading shrinks as the foam's force does, and was never more.
    pub(super) fn believed_n(&self, foam: &FoamCurve, depth: T) -> T {
        self.force * (foam.force_n(depth) / self.body_n).min(T::one())
    }

    /// Speed outward after a release, m/s: who walked into the base, and got more room than was needed, may still be
    /// walking.
    pub(super) fn released_limit(&self, s: &BarrierSettings) -> T {
        let rising = (self.released - of(s.creep_s)).max(T::zero());
        let creeping = of::<T>(s.creep_m_s) + of::<T>(s.recovery_m_s2) * rising;
        // the base goes on to whom it met when it is no longer held
        let slow_s = if self.came() { RECOVERS_S } else { 2.0 * RECOVERS_S };
        let again = (self.met * of(AGAIN)).max(of(SLOWEST_M_S));
        let later = (self.near - of(slow_s)).max(T::zero());
        let closing = creeping.min(again + of::<T>(s.recovery_m_s2) * later);
        if closing < T::one() {
            (closing - self.person_m_s()).max(of(-s.retreat_m_s))
        } else {
            of(f64::INFINITY)
        }
    }

    /// Speed outward of a touched taxel without readings, m/s: back for a while, then no further out.
    pub(super) fn blind_limit(&self, s: &BarrierSettings, way: T) -> T {
        let gone = self.blind_from.map_or(T::zero(), |from| from - way);
        let goes_on = gone < of(BLIND_RETREAT_M) && self.since < of(BLIND_RETREAT_S);
        if goes_on { of(-s.retreat_m_s) } else { T::zero() }
    }
}
