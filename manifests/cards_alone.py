"""Sets with a card alone: no public text lists their files.

Sources stand on each card.
"""

from __future__ import annotations

from eldata.manifest.card import CameraCard, Card, Download
from manifests.published_sidd import CAMERAS as SIDD_CAMERAS

_AIM_CODE = "starter kit (SonyResearch/AIM2025_Denoise_Challenge), commit 5d6531d"
_AIM_PAPER = "arXiv 2510.06601"

AIM25 = Card(
    name="aim25",
    title="AIM 2025 Challenge on Real-World Raw Image Denoising",
    version="1.0",
    folder="AIM25",
    citation="AIM 2025 Challenge on Real-World RAW Image Denoising, arXiv 2510.06601, 2025",
    licence="for the challenge and research, no commercial use (page of the challenge); MIT for the starter kit's code",
    homepage="https://github.com/SonyResearch/AIM2025_Denoise_Challenge",
    cfa="bayer",
    cameras={name: CameraCard(()) for name in ("Canon70D", "SonyA6700", "SonyA7R4", "SonyZVE10M2")},
    counts={},
    downloads=(
        Download("https://www.codabench.org/competitions/8529/", notes="the challenge's page: registration is needed"),
    ),
    known_defects=(
        (
            "The paper's abstract speaks of five cameras; the starter kit and the page of the challenge have four. The "
            "page has gains 10, 100 and 200 of the paired scenes, the paper 100 and 200; of those in the wild 10 to "
            "200, the paper 10 to 100."
        ),
        (
            "LibRaw's visible area is not what is scored: the starter kit has an area of each camera's whole mosaic "
            "(camera_config.yaml, valid_roi), 3670 x 5496 of the Canon from row 38 and column 72."
        ),
    ),
    sources=(
        (
            f"{_AIM_CODE}, README, datasets/, save_for_stage1_submission.py, save_for_stage2_submission.py, "
            "utils/utils.py, index.html (page of the challenge): layout, names, levels, areas, scores, licence"
        ),
        f"{_AIM_PAPER} and its summaries: scenes, ISOs, gains, metrics",
    ),
    contents=(
        "ELD's design. Paired: 10 indoor scenes a camera, ISO 800, 1600 and 3200, digital gains 100 and 200, a long "
        "exposure of base ISO; names <camera>/test_data/paired_input/scene<n>_iso<iso>_dgain<gain>.{ARW,CR2}. In the "
        "wild: 40 scenes a camera without reference, 10 for validation and 30 for testing, ISO 800, 1250, 1600, 3200 "
        "and 6400. Also 50 dark frames of each ISO, dark shading and system gains"
    ),
    levels="LibRaw's white level; the mean of LibRaw's black levels for all channels (the starter kit)",
    scored=(
        (
            f"{_AIM_CODE}: the prediction, already multiplied by the gain and clipped to [0, 1], as 16-bit integers. "
            "Development: PSNR and SSIM (scikit-image) of the central 512 x 512 packed pixels."
        ),
        (
            "Ranking: ranks in PSNR and SSIM on the whole raw frame, LPIPS on a simple sRGB rendering, and ARNIQA and "
            "TOPIQ on renderings of the scenes without reference."
        ),
        (
            "No protocol of eldata's: the scored area, one black level for all channels, and LPIPS, ARNIQA and TOPIQ "
            "cannot be said by one."
        ),
    ),
    unknown=(
        "Which numbers the scenes have, and which are in which phase: so eldata cannot list the files.",
        "Whether the references were published after the challenge; the starter kit says that they are not.",
        "How the Sony files name their cameras, and the ISO and exposure of the references.",
    ),
)

_FIVEK_HELD = "5,000 photographs by several photographers and cameras, each as a DNG file and retouched by five experts"

FIVEK = Card(
    name="fivek",
    title="MIT-Adobe FiveK: clean raw photographs of many cameras",
    version="1.0",
    folder="FiveK",
    citation=(
        "V. Bychkovsky, S. Paris, E. Chan and F. Durand, Learning Photographic Global Tonal Adjustment with a Database "
        "of Input / Output Image Pairs, IEEE Conference on Computer Vision and Pattern Recognition, 2011"
    ),
    licence="research use, by two texts of the publishers that cover a list of files each: read them on the set's page",
    homepage="https://data.csail.mit.edu/graphics/fivek/",
    cfa="bayer",
    cameras={},
    counts={},
    downloads=(
        Download(
            "https://data.csail.mit.edu/graphics/fivek/",
            notes="the set's page, with one archive of all and the files one by one",
            about="50 GB",
        ),
    ),
    known_defects=(
        "Photographs as they were taken: that they are clean enough is the ELD paper's assumption.",
        (
            "Cameras of 12 to 16 bits: their white levels differ, so noise of a profile needs its own range_dn, and "
            "levels are the files' (docs/training.md, clean frames of other cameras)."
        ),
    ),
    sources=(
        "The paper of the set, abstract: 5,000 photos, five retouchers",
        "Public code and pages that fetch the set: DNG, two licence texts, some 50 GB",
        "K. Wei et al., TPAMI 2021, section 4.3.2: used as clean images beside SID",
    ),
    contents=f"{_FIVEK_HELD}. eldata uses the DNG files alone, as clean frames for synthetic noise",
    levels="those of each file",
    scored=("Nothing: it has no noisy frames, and eldata has no protocol for retouching.",),
    unknown=(
        "The list of files was not read, so eldata has no manifest. A folder of the DNG files needs none as --clean.",
        "Which photographs the ELD paper took, and whether all of them; and which files hold no Bayer mosaic.",
    ),
)

LLD = Card(
    name="lld",
    title="Low-light denoising dataset LLD, with dark and flat-field frames",
    version="1.0",
    folder="LLD",
    citation=(
        "Y. Cao, M. Liu, S. Liu, X. Wang, L. Lei and W. Zuo, Physics-Guided ISO-Dependent Sensor Noise Modeling for "
        "Extreme Low-Light Photography, IEEE/CVF Conference on Computer Vision and Pattern Recognition, 2023"
    ),
    licence="none stated",
    homepage="https://github.com/happycaoyue/LLD",
    cfa="bayer",
    cameras={"SonyA7S2": CameraCard(()), "NikonD850": CameraCard(())},
    counts={},
    downloads=(Download("https://pan.baidu.com/s/1eLKzjOSDCR4NNLcvbyenEQ?pwd=WAXY", notes="Baidu, of the authors"),),
    known_defects=(
        (
            "Two users found bias frames (LLD_BiasFrame_ET_1_30) and flat-field frames in the download, but no pairs "
            "(issue 2, without an answer)."
        ),
        "The published code tests on ELD and SID alone; none reads LLD.",
    ),
    sources=(
        "LLD repository, commit 85afa0b and branch master, README: cameras, contents, download; Codes: no loader",
        "LLD repository, issue 2: what the download holds",
        "SonyResearch/raw_image_denoising, issues 4 and 5: dark frames of the A7S II, black level 512 of 14 bits",
    ),
    contents=(
        "Pairs of noisy (high ISO, short exposure) and clean (low ISO, long exposure) frames, dark frames and "
        "flat-field frames over a range of ISOs, of a Sony A7S II and a Nikon D850"
    ),
    scored=("No code that scores on it was published, so eldata has no protocol.",),
    unknown=(
        "Names, formats and numbers of the files, scenes, ISOs and ratios: the paper's supplement was not read.",
        "Levels: those that the files state.",
    ),
)

RAWNIND = Card(
    name="rawnind",
    title="Raw Natural Image Noise Dataset (RawNIND)",
    version="1.0",
    folder="RawNIND",
    citation=(
        "B. Brummer and C. De Vleeschouwer, Learning Joint Denoising, Demosaicing, and Compression from the Raw "
        "Natural Image Noise Dataset, arXiv 2501.08924, 2025; data: doi:10.14428/DVN/DEQCIM"
    ),
    licence="CC BY-SA 4.0 for the set; some scenes have permissions of their own (pages of the set)",
    homepage="https://doi.org/10.14428/DVN/DEQCIM",
    cfa="both",
    cameras={},
    counts={},
    downloads=(
        Download(
            "https://dataverse.uclouvain.be/dataset.xhtml?persistentId=doi:10.14428/DVN/DEQCIM",
            notes="2845 files, one by one; the code's README has a command that fetches all",
            about="120 GB",
        ),
    ),
    known_defects=(
        (
            "References and noisy frames need aligning, masks and gains, which the authors' code computes; it leaves "
            "out about 2 % of the images each for a mask that is too large or an alignment that failed."
        ),
        "A scene may have several references; which one a noisy frame is compared with is the code's choice.",
        (
            "Dataverse counts 2845 files, the index of the authors' code 2837. Of these one is a JPEG and 11, all of "
            "the camera that is not trained on, are darktable's XMP, listed as references; two state ISO as Hi 3200."
        ),
    ),
    sources=(
        (
            "RawNIND repository (trougnouf/rawnind_jddc), commit 4d455aa, src/rawnind/README.md, "
            "datasets/RawNIND/organize_files.sh, src/rawnind/libs/rawds.py, src/rawnind/config/test_reserve.yaml: "
            "layout, names, test scenes, thresholds"
        ),
        (
            "The same repository, commit 1245777, src/rawnind/datasets/RawNIND/src/dataset_index.yaml: every file's "
            "name and SHA-1 by scene; commit cf592a5, datasets/RawNIND/RawNIND_masks_and_alignments.yaml: shifts of "
            "(0, 0), (2, -2) and (4, 0) pixels and gains of 1.0 to 2.5 of 49 pairs of four scenes"
        ),
        (
            "CommReteris/rawnind_jddc, commit d364f8c, datasets/RawNIND/dataset.yaml: Dataverse's answer, with sizes "
            "and MD5"
        ),
        "Metadata of the set on Dataverse, version 1: number of files, citation",
        "Public code that fetches the set: its licence and its size, 120.17 GB",
    ),
    contents=(
        "Raw files of many cameras, several ISOs of each scene: by the code's index 196 scenes of Bayer cameras, with "
        "435 references and 1739 noisy frames, and 111 of X-Trans, with 132 and 531; names such as "
        "Bayer_TEST_7D-2_GT_ISO100_sha1=<hash>.cr2: filter array, scene, GT for references, ISO, and the file's SHA-1. "
        "The code's layout: src/<Bayer or X-Trans>/<scene>/, references below gt/"
    ),
    levels="those of each file",
    scored=(
        (
            "The authors' code compares linear Rec. 2020 RGB, or renderings of each scene by darktable, after "
            "alignment and gain matching, by MS-SSIM and others; 10 scenes are reserved for tests, and 6 of a camera "
            "that is not trained on."
        ),
        "No protocol of eldata's: alignment, masks, RGB of raw predictions and MS-SSIM cannot be said by one.",
    ),
    unknown=(
        (
            "Camera, exposure time and so the ratio of each file: they stand in the files alone, so eldata has no "
            "manifest, and eldata manifest makes that of a copy. Every name carries its SHA-1."
        ),
        "The shifts and gains of most pairs, which the authors' code computes.",
    ),
)

_SIDD_CC = "card of the set on Hugging Face (MhdMohammadi/SIDD-CC)"

SIDD_CC = Card(
    name="sidd-cc",
    title="SIDD-CC: SIDD with ground truth made again, without its colour shift",
    version="1.0",
    folder="SIDD-CC",
    citation=(
        "M. Mohammadi et al., Why Low-Light Cameras Go Color Blind: Removing Color Bias in Raw Denoising, IEEE "
        "International Conference on Computational Photography, 2026, arXiv 2607.11090"
    ),
    licence="SIDD's terms of use (the set's card on Hugging Face)",
    homepage="https://mhdmohammadi.github.io/SIDD-CC/",
    cfa="bayer",
    cameras={name: CameraCard(()) for name in SIDD_CAMERAS.values()},
    counts={},
    downloads=(
        Download("https://huggingface.co/datasets/MhdMohammadi/SIDD-CC", notes="Raw 23 GB, sRGB 8.1 GB"),
        Download(
            "https://huggingface.co/datasets/MhdMohammadi/SIDD-CC-DNG",
            notes="the training instances' DNG files, 17,250 of 234.5 GB",
        ),
    ),
    known_defects=(
        (
            "56 of SIDD's 200 scene instances are not in it: 34 are no longer served, and those of the Galaxy S6 that "
            "the phone clipped at black were left out."
        ),
    ),
    sources=(
        f"{_SIDD_CC}: layout, form of the arrays, sizes, terms",
        "Card of its DNG files (MhdMohammadi/SIDD-CC-DNG): numbers of instances, the split",
        "Page of the paper (MhdMohammadi/SIDD-CC on GitHub, commit b5f1a00): what was wrong with SIDD's ground truth",
    ),
    contents=(
        "144 scene instances of SIDD, 115 to train with and 29 to test on; Raw/train/Data/<instance>/*.MAT after the "
        "official medium set, Raw/test/Benchmark*Blocks*.mat. References average frames first and are clipped last, "
        "where SIDD's frames were clipped before"
    ),
    levels="float32 mosaics, black subtracted, left unclipped: black 0, and values below it",
    scored=(
        (
            "No public code scores it. Of the training frames a manifest of one's own and the protocol sfrn-sidd do "
            "(docs/datasets.md); its test data are blocks."
        ),
    ),
    unknown=(
        (
            "Which of SIDD's instances are in it: the lists were not read, so eldata cannot list the files; and how "
            "the arrays of the blocks are called."
        ),
        "Whether 1 is white, as in SIDD's files, or the numbers are DN; which of MATLAB's formats the files have.",
    ),
)

CARDS_ALONE = (AIM25, FIVEK, LLD, RAWNIND, SIDD_CC)
