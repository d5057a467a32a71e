//! One touched taxel from reading to reading, and where the base has been meanwhile.

use super::{BLIND_RETREAT_M, BLIND_RETREAT_S, BarrierSettings, FoamCurve, TaxelSample};
use crate::guard::FORGOTTEN_M_S;
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
/// A late base that no longer waits for who came to it comes back slowly to who did within so long, s.
const FOLLOWED_S: f64 = 60.0;
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

/// Memory of one taxel.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub(super) struct Track<T> {
    contact: Contact<T>,
    /// The last reading; `None` before the first.
    last: Option<Reading<T>>,
    /// Estimate of the person's speed, m/s; after a release what is still remembered of it.
    person: T,
    /// Fastest that the person came to a late base, m/s, as it is remembered.
    fastest: T,
    /// Speed outward before the last reading without even a light touch, m/s.
    approach: T,
    /// Speed at which the base met who touches, or did until a moment ago, m/s: 0 if it stood. `None` before the first touch.
    met: Option<T>,
    /// Way outward where the readings ended that could be believed, m.
    blind_from: Option<T>,
    /// Search for who touched here or beside it; `None` before the first touch.
    search: Option<Search<T>>,
}

/// Contact of one taxel with a person.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
enum Contact<T> {
    /// Nobody has touched yet.
    Untouched,
    /// Somebody touches.
    Touched(Touch<T>),
    /// Nobody is felt any more since so long, s.
    Released(T),
}

/// A touch, as its readings show it.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Touch<T> {
    /// Readings since the touch began.
    readings: u8,
    /// One of them was no light touch.
    firm: bool,
    /// Compression at the last reading, m, the reading itself and the force on all of the body, N.
    depth: T,
    force: T,
    body_n: T,
    /// Plates like this one that the body presses.
    plates: T,
    /// Rate of the compression, m/s, and yield rate of the softest body that is assumed, m/s.
    rate: T,
    yields: T,
}

impl<T: Scalar> Touch<T> {
    /// Begins before its first reading.
    fn begin() -> Self {
        let zero = T::zero();
        Self {
            readings: 0,
            firm: false,
            depth: zero,
            force: zero,
            body_n: zero,
            plates: T::one(),
            rate: zero,
            yields: zero,
        }
    }
}

/// Place and time of a reading.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Reading<T> {
    /// Way outward that the base had gone then, m.
    way: T,
    /// Time since it was taken, s.
    since: T,
}

/// Search for a person who may still touch although nothing is felt: the base goes no further than where it met her, and looks.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
struct Search<T> {
    /// Way outward beyond which the base does not go, m; `None` where it goes on.
    far: Option<T>,
    /// Time since somebody touched here or beside it, s.
    near: T,
    /// True if the touch was here.
    here: bool,
    /// Time for which the base has stood there since, s.
    looked: T,
}

impl<T: Scalar> Search<T> {
    fn is_there(&self, way: T) -> bool {
        self.far.is_some_and(|far| way > far - of(THERE_M))
    }
}

impl<T: Scalar> Track<T> {
    /// Nobody has touched yet.
    pub(super) fn none() -> Self {
        let zero = T::zero();
        Self {
            contact: Contact::Untouched,
            last: None,
            person: zero,
            fastest: zero,
            approach: zero,
            met: None,
            blind_from: None,
            search: None,
        }
    }

    const fn touch(&self) -> Option<&Touch<T>> {
        if let Contact::Touched(touch) = &self.contact { Some(touch) } else { None }
    }

    pub(super) const fn touched(&self) -> bool {
        self.touch().is_some()
    }

    /// Returns true if the touch here ended less than so long ago, s.
    fn released_within(&self, time_s: f64) -> bool {
        matches!(self.contact, Contact::Released(since) if since < of(time_s))
    }

    /// Returns true if a touch ended so recently that it may go on undetected, or if the base has not looked yet.
    pub(super) fn was_touched(&self) -> bool {
        let looks = self.search.is_some_and(|search| search.here && search.far.is_some());
        self.released_within(if looks { 2.0 * RECOVERS_S } else { RECOVERS_S })
    }

    /// Returns true if the person came to a base that stood.
    fn came(&self) -> bool {
        self.met.is_some_and(|met| met < of(SLOWEST_M_S))
    }

    /// Plates like this one that the body presses, ≥ 1.
    pub(super) fn plates(&self) -> T {
        self.touch().map_or(T::one(), |touch| touch.plates)
    }

    pub(super) fn person_m_s(&self) -> T {
        let yields = self.touch().map_or(T::zero(), |touch| touch.yields);
        (self.person + yields).max(self.fastest)
    }

    /// Returns true if the following step takes `sample` in as a reading of its own.
    pub(super) fn is_new(&self, sample: Option<TaxelSample<T>>, dt_s: T) -> bool {
        let is_later = |last: Reading<T>, age_s| age_s - of::<T>(0.5) * dt_s < last.since;
        sample.is_some_and(|sample| self.last.is_none_or(|last| is_later(last, sample.age_s)))
    }

    /// Time passes, and the base is `way` outward. Of the speed at a release, and of the fastest, these shares are forgotten.
    pub(super) fn wait(&mut self, dt_s: T, [forgotten, of_fastest]: [T; 2], way: T) {
        if let Some(last) = &mut self.last {
            last.since += dt_s;
        }
        if let Contact::Released(since) = &mut self.contact {
            *since += dt_s;
        }
        if let Some(search) = &mut self.search {
            search.near += dt_s;
            if search.is_there(way) {
                search.looked += dt_s;
            }
            let looks = search.here && search.looked < of(LOOKS_S) && search.near < of(2.0 * RECOVERS_S);
            if search.near > of(RECOVERS_S) && !looks {
                (search.far, search.here) = (None, false);
            }
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
        let (far, was_here) = self.search.map_or((None, false), |search| (search.far, search.here));
        let (near, looked) = (T::zero(), T::zero());
        self.search = Some(Search { far: far.or(way), near, here: was_here || here, looked });
    }

    /// The base stands `way` outward to look whether somebody still touches beside it: held over the next step.
    pub(super) fn stay(&mut self, way: T, dt_s: T) {
        let held = of::<T>(RECOVERS_S) - (dt_s + dt_s);
        let fresh = Search { far: None, near: held, here: false, looked: T::zero() };
        let search = self.search.get_or_insert(fresh);
        search.near = search.near.min(held);
        search.far = search.far.or(Some(way));
    }

    /// Returns true if the base looks, `way` outward, for a person here who has not been detected for long.
    pub(super) fn looks(&self, way: T) -> bool {
        let looks = |s: Search<T>| s.here && s.near > of(RECOVERS_S) && s.is_there(way);
        self.search.is_some_and(looks)
    }

    /// The base met who touches at this speed outward, m/s: the least of them, if it was here a moment ago.
    fn meet(&mut self, speed: T) {
        let was_here = self.search.is_some_and(|search| search.here);
        self.met = Some(if was_here {
            let again = speed.max(of(SLOWEST_M_S));
            self.met.map_or(again, |met| met.min(again))
        } else {
            speed.max(T::zero())
        });
    }

    /// Way outward beyond which the base does not go, m.
    pub(super) fn far(&self) -> Option<T> {
        self.search.and_then(|search| search.far)
    }

    /// The reading can be believed.
    pub(super) fn find(&mut self) {
        self.blind_from = None;
    }

    /// Takes in a reading of its own.
    pub(super) fn take(&mut self, settings: &BarrierSettings, felt: &Felt<T>) {
        let Felt { sample, light, body_n, plates, way } = *felt;
        self.find();
        let before = self.last.replace(Reading { way, since: sample.age_s });
        // the time since the reading before, s, and the way outward since then, m
        let gone = before.map(|before| (before.since - sample.age_s, way - before.way));
        if sample.force_n < of(settings.touch_n) {
            match self.contact {
                Contact::Touched(touch) => self.release(&touch),
                // what a first reading is measured against
                Contact::Untouched | Contact::Released(_) if light => self.meet(self.approach),
                Contact::Untouched | Contact::Released(_) => self.approach = speed_of(gone),
            }
            return;
        }
        let mut touch = self.touch().copied().unwrap_or(Touch::begin());
        let depth = settings.foam.depth_m(body_n);
        let is_known = self.released_within(settings.forget_s);
        let assumed = if is_known { self.person } else { of(settings.first_speed_m_s) };
        if let Some(gone) = gone.filter(|(interval, _)| *interval < of(APART_S)) {
            self.estimate(settings, &mut touch, depth, gone);
        }
        if !self.touched() {
            self.person = self.person.max(assumed);
            // a light touch may have stopped the base before there was a reading
            self.meet(speed_of(gone).max(self.approach));
        }
        touch.readings = touch.readings.saturating_add(1);
        // a base that obeys at once takes no light touch for a reading
        touch.firm |= !light || settings.remember_s <= 0.0;
        // what a late base does shows in its readings after so long that a person who slows down and one whom it leaves look alike
        if settings.remember_s > 0.0 && touch.readings > ASSUMED && touch.firm {
            self.fastest = self.fastest.max(self.person + touch.yields);
        }
        (touch.depth, touch.force, touch.body_n, touch.plates) = (depth, sample.force_n, body_n, plates);
        self.contact = Contact::Touched(touch);
    }

    /// Nobody is felt any more.
    fn release(&mut self, touch: &Touch<T>) {
        // one reading's speed was assumed and not seen, and light ones may have been a false alarm
        let seen = touch.readings > 1 && touch.firm;
        self.person = if seen { self.person_m_s() } else { T::zero() };
        self.approach = T::zero();
        self.contact = Contact::Released(T::zero());
    }

    /// The person's speed: what the compression has gained that the base has not gone in an interval, s, and a way, m.
    fn estimate(
        &mut self,
        settings: &BarrierSettings,
        touch: &mut Touch<T>,
        depth: T,
        (interval, gone): (T, T),
    ) {
        let before = if self.touched() {
            touch.depth
        } else if self.was_touched() {
            // who was touched a moment ago may still be, by what the threshold hides
            depth.min(settings.reading.depth_m(of(settings.hidden_n)))
        } else {
            T::zero()
        };
        let rate = (depth - before) / interval;
        let raw = rate - gone / interval;
        // Readings are averaged. What the first one had to assume is replaced by the second where the base itself moved, and
        // counts like any other where it stood, or is late: who touches it then has come, or may have.
        let recent = interval / interval.max(of(settings.speed_s));
        let late = settings.remember_s > 0.0;
        let counts = self.came() || late;
        let seen = touch.readings.saturating_add(u8::from(counts)).max(1);
        let weight = recent.max(T::one() / of(f64::from(seen)));
        let person = self.person + weight * (raw - self.person);
        self.person = person.clamp(of(-NOISE_M_S), of(settings.fastest_person_m_s));
        if late && touch.readings < ASSUMED {
            self.person = self.person.max(of(settings.first_speed_m_s));
        }
        touch.rate += weight * (rate - touch.rate);
        // of a soft body the foam shows only a part of how it comes; what the base itself closes says nothing of it, and
        // noise alone, of which only what lies above 0 counts, shows nearly half its own size
        let noise = of::<T>(0.5 * settings.speed_noise_m_s);
        let seen = (touch.rate.min(self.person) - noise).max(T::zero());
        let yields = seen * settings.foam.slope_n_m(depth) / of(settings.softest_n_m);
        touch.yields = yields.min(of::<T>(settings.fastest_person_m_s) - self.person);
    }

    /// Compression now, m, the base being `way` outward; 0 where nothing touches.
    pub(super) fn depth_now(&self, way: T) -> T {
        let Some((touch, last)) = self.touch().zip(self.last) else { return T::zero() };
        touch.depth + way - last.way + self.person_m_s() * last.since
    }

    /// Force that a law may count on at this compression, N: a reading shrinks as the foam's force does, and was never more.
    pub(super) fn believed_n(&self, foam: &FoamCurve, depth: T) -> T {
        let believed = |touch: &Touch<T>| touch.force * (foam.force_n(depth) / touch.body_n).min(T::one());
        self.touch().map_or(T::zero(), believed)
    }

    /// Speed outward after a release, m/s: who walked into the base, and got more room than was needed, may still be
    /// walking.
    pub(super) fn released_limit(&self, s: &BarrierSettings) -> T {
        let mut closing = of(f64::INFINITY);
        if let Contact::Released(since) = self.contact {
            let rising = (since - of(s.creep_s)).max(T::zero());
            closing = of::<T>(s.creep_m_s) + of::<T>(s.recovery_m_s2) * rising;
        }
        if let Some((met, search)) = self.met.zip(self.search) {
            // the base goes on to whom it met when it is no longer held
            let slow_s = if self.came() { RECOVERS_S } else { 2.0 * RECOVERS_S };
            let again = (met * of(AGAIN)).max(of(SLOWEST_M_S));
            let later = (search.near - of(slow_s)).max(T::zero());
            closing = closing.min(again + of::<T>(s.recovery_m_s2) * later);
        }
        if self.fastest > T::zero() && self.released_within(FOLLOWED_S) {
            // who came may follow a late base: it waits, and comes back slowly
            let waits = self.fastest > of(FORGOTTEN_M_S);
            closing = closing.min(if waits { T::zero() } else { of(SLOWEST_M_S) });
        }
        if closing < T::one() {
            (closing - self.person_m_s()).max(of(-s.retreat_m_s))
        } else {
            of(f64::INFINITY)
        }
    }

    /// Speed outward of a touched taxel without readings, m/s: back for a while, then no further out.
    pub(super) fn blind_limit(&self, s: &BarrierSettings, way: T) -> T {
        let gone = self.blind_from.map_or(T::zero(), |from| from - way);
        let is_recent = self.last.is_some_and(|last| last.since < of(BLIND_RETREAT_S));
        let goes_on = gone < of(BLIND_RETREAT_M) && is_recent;
        if goes_on { of(-s.retreat_m_s) } else { T::zero() }
    }
}

/// Speed outward of the base, m/s, that has gone so far, m, in so long, s; 0 before the first reading.
fn speed_of<T: Scalar>(gone: Option<(T, T)>) -> T {
    gone.map_or(T::zero(), |(interval, way)| way / interval)
}
