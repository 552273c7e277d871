//! An order in which neighbours in space are neighbours in a list.

/// Brings items into an order in which runs of each of some lengths are close together: recursive cuts, at
/// multiples of the longest that is shorter than what is cut, along the feature of largest extent. The longest comes
/// first. `key` gives an item's features and a number of its own, by which items of the shortest runs are ordered.
pub fn arrange<T: Send, const N: usize>(
    items: &mut [T],
    runs: &[usize],
    key: &(impl Fn(&T) -> ([f32; N], u32) + Sync),
) {
    let Some(&run) = runs.iter().find(|run| items.len() > **run) else {
        items.sort_unstable_by_key(|item| key(item).1);
        return;
    };
    let mut range = [(f32::INFINITY, f32::NEG_INFINITY); N];
    for item in items.iter() {
        for ((low, high), value) in range.iter_mut().zip(key(item).0) {
            (*low, *high) = (low.min(value), high.max(value));
        }
    }
    let extent = |axis: usize| range[axis].1 - range[axis].0;
    let axis = (0..N)
        .max_by(|&a, &b| extent(a).total_cmp(&extent(b)))
        .unwrap_or(0);
    let middle = (items.len() / 2).next_multiple_of(run);
    // Ties are broken by number: the cut does not depend on the selection's implementation.
    items.select_nth_unstable_by(middle, |a, b| {
        let ((a, first), (b, second)) = (key(a), key(b));
        a[axis].total_cmp(&b[axis]).then(first.cmp(&second))
    });
    let (lower, upper) = items.split_at_mut(middle);
    rayon::join(|| arrange(lower, runs, key), || arrange(upper, runs, key));
}
