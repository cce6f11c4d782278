"""Look at the pieces that need a person, and at nothing else.

A model of two people labels a third one, with seven of fifteen markers hidden and three ghosts at every moment. `review` ranks the
pieces of paths by the number of samples that an answer is expected to correct. Here the truth answers. The picture shows how fast
the errors go.
"""

import matplotlib.pyplot as plt

import asterism
from asterism.labelling import apply_answers, review
from asterism.simulation import simulate_gaps_and_ghosts, simulate_walks


def main(picture: str = "review_what_is_uncertain.png", subjects: int = 3, frames: int = 400) -> list[int]:
    """Draw the picture; returns how many samples are wrong or missing after each answer."""
    *training, walk = simulate_walks(subjects, frames, markers="helen-hayes", seed=5)
    model = asterism.MarkerModel.fit(training, seed=0)
    clouds, truth = simulate_gaps_and_ghosts(walk, hidden=7, ghosts=3, seed=6)
    labelling = model.label(clouds)

    items = review(labelling, clouds, top=40)
    remaining = [int((labelling.indices != truth).sum())]
    for item in items:
        places = item.points - clouds.offsets[clouds.frame_of[item.points]]
        is_marker = (truth[clouds.frame_of[item.points]] == places[:, None]).sum(axis=0)
        answer = walk.labels[is_marker.argmax()] if is_marker.any() else None
        labelling = apply_answers(labelling, clouds, [(item, answer)])
        remaining.append(int((labelling.indices != truth).sum()))
    print(f"wrong or missing samples: {remaining[0]} before, {remaining[-1]} after {len(items)} answers")

    figure, (ranks, errors) = plt.subplots(1, 2, figsize=(10, 5.5), layout="constrained")
    ranks.barh(range(len(items)), [item.gain for item in items], color="#0f7b8a")
    ranks.set_yticks(range(len(items)), [f"{item.marker or 'no label'}, frame {item.frame}" for item in items], fontsize=7)
    ranks.invert_yaxis()
    ranks.set(title="what to look at first", xlabel="samples that an answer is expected to correct")
    errors.step(range(len(remaining)), remaining, where="post", color="#d1495b")
    errors.set(title="what the answers correct", xlabel="answers", ylabel="samples wrong or missing", ylim=(0, None))
    errors.grid(alpha=0.3)
    figure.savefig(picture, dpi=110)
    return remaining


if __name__ == "__main__":
    main()
