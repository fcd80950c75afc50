"""Datasets on storage that is no disk: anything that fsspec reaches by a URL, such as s3://.

`store.Store` is the storage, `copies` the local copies through which everything else sees it,
`publish` what a run writes there, and the lock that keeps two runs apart.
"""
